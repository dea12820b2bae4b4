"""The work done, and which method comes first."""

from collections.abc import Sequence
from typing import Any

from novags.methods import METHODS
from novags.testbed.folders.run import Run
from novags.testbed.report.blocks.cost import costs
from novags.testbed.report.blocks.ranking import ranking
from novags.testbed.report.grid import verdict as verdict_of_many
from novags.testbed.report.material import Material, Place
from novags.testbed.report.parts import Page
from novags.testbed.report.verdict import leading, verdict
from novags.testbed.report.words import duration, join
from novags.testbed.study.results import counted

APART = (
    "Runs of one capture have the same truth and are compared with each other; between captures the truth differs, and "
    "so does what a score means."
)


def header(material: Material, page: Page) -> dict[str, Any]:
    """The first screen: title, verdict, the film strip, the ranking and its chart; and the work done."""
    found: dict[str, Any] = {"title": material.title, "short": "", "strip": page.strip, "ranking": ranking(material),
                             "other": [f"run {number}" for number in material.other]}  # fmt: skip
    said = ""
    if (place := material.one) is not None:
        said, found["what"] = verdict(place), what_was_done(place, sum(row["seconds"] for row in costs(material)))
        found["short"] = short(list(place.runs.values()))
    elif material.study:
        said = verdict_of_many(material.lines, material.competes)
        found["what"] = f"{', '.join(f'{count} {state}' for state, count in counted(material.rows).items())}."
    else:
        found["what"] = f"{len(material.places)} captures, {len(material.rows)} runs. {APART}"
    headline, _, rest = said.partition(". ")
    return {**found, "headline": f"{headline}." if rest else headline, "rest": rest}


def short(runs: Sequence[Run]) -> str:
    """In words that fits are shorter than their methods were published with; "" where none is."""
    lengths = set[tuple[int, int]]()
    for run in runs:
        row, fit = METHODS.get(run.method), run.record["config"].get("fit", {})
        published = None if row is None else getattr(getattr(row.config(), "fit", None), "iterations", None)
        if published is not None and 0 < fit.get("iterations", 0) < published:
            lengths.add((fit["iterations"], published))
    if not lengths:
        return ""
    told = ", ".join(f"{here:,} of {published:,}" for here, published in sorted(lengths))
    return f"Fits took {told} iterations: stopping early favours methods that do not denoise."


def what_was_done(place: Place, seconds: float) -> str:
    """One sentence: scene, camera, light, methods, time."""
    record, rendered, lost = place.capture.record, place.lit.views.kind == "rendered", len(place.lit.views.unregistered)
    what, methods = f"{place.scene} ({record.width} × {record.height} px)", join(list(place.runs))
    if (told := record.simulated) is None:
        seen = "scored on" if leading(place) is not None else "rendered from"
        return (f"{record.views} dark photographs of {what} were imported, reconstructed by {methods}, and {seen} "
                f"views that no method had seen; all of it took {duration(seconds)}.")  # fmt: skip
    views = f"{record.views}{f' of {record.views + lost}' if lost else ''} {'views' if rendered else 'photographs'}"
    return (
        f"{views} of {what} were {'rendered, ' if rendered else ''}taken in the dark by a simulated "
        f"{record.sensor_name} camera at {told.electrons:g} electrons per green pixel, reconstructed by {methods}, and "
        f"scored on views that no method had seen; all of it took {duration(seconds)}."
    )
