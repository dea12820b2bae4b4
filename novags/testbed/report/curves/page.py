"""What a measured subject leaves in its folder: lines of JSON, a figure, tables; and its sizes in a page."""

from collections.abc import Sequence
from pathlib import Path

from novags.testbed.report.curves.figure import figure
from novags.testbed.report.curves.table import heading, tables
from novags.testbed.study.curves.curve import CURVES, Point, Row, curves, write_curves
from novags.testbed.study.knobs.knob import Subject
from sensor_model.files.atomic import write_text

TITLES = {
    "render": "Renderer: error of a view", "sensor": "Sensor model: error of a frame",
    "splats": "Splat engine: error of a picture",
}  # fmt: skip


def write(subject: Subject, rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write `curves.jsonl`, `NAME.svg` and `NAME.md` from the table of a subject's study; returns the three."""
    points = curves(subject, rows)
    lines, picture, table = written(subject.name, folder)
    write_curves(folder, points)
    own = f"Reconstruction by {subject.workload.get('method', 'a method')}: error of held-out views"
    write_text(picture, figure(points, TITLES.get(subject.name, own)))
    write_text(table, f"{heading(points)}\n\n{tables(points)}")
    return [lines, picture, table]


def written(name: str, folder: Path) -> list[Path]:
    """The three files of a subject."""
    return [folder / CURVES, folder / f"{name}.svg", folder / f"{name}.md"]


def marks(name: str) -> tuple[str, str]:
    """The two lines of a page between which the sizes of a subject's measurements stand."""
    return f"<!-- curves: {name} -->", "<!-- end of curves -->"


def embedded(page: str, points: list[Point]) -> str:
    """A page that says how these points were measured, between the marks of their subjects."""
    for name in dict.fromkeys(point["knob"].partition(".")[0] for point in points):
        begin, end = marks(name)
        head, found, rest = page.partition(begin)
        if found and end in rest:
            own = [point for point in points if point["knob"].startswith(f"{name}.")]
            page = f"{head}{begin}\n\n{heading(own)}\n\n{end}{rest.partition(end)[2]}"
    return page
