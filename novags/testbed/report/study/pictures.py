"""The pictures of a study: of every place one held-out view, dark, in good light, and as each method renders it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from novags.testbed.folders.capture import Capture
from novags.testbed.folders.imported import is_imported
from novags.testbed.folders.run import Run
from novags.testbed.report.look.album import Album
from novags.testbed.report.look.maps import error_map
from novags.testbed.report.look.probe import Probe, probe_of
from novags.testbed.report.pictures import Tile, ViewTiles
from novags.testbed.report.study.grid import Line, by_place
from novags.testbed.report.study.records import Records
from novags.testbed.study.grid import spelled
from sensor_model import sensor_from_dict
from simscenes.sets.multiview import load_set
from simscenes.sets.pictures.png import read_png


def study_views(
    lines: Sequence[Line], records: Records, album: Album
) -> tuple[list[ViewTiles], dict[str, str]]:  # fmt: skip
    """The pictures of every place that has a finished run on this machine; and the places without, with the reason."""
    found, lost = list[ViewTiles](), dict[str, str]()
    for members in by_place(lines).values():
        place = spelled(members[0].place) or "all runs"
        runs = {line.method: number for line in members if (number := _first(line, records)) is not None}
        try:
            view = _view(place, runs, records, album) if runs else None
        except (ValueError, OSError) as error:  # one damaged file must not cost the page of a thousand runs
            lost[place] = str(error)
            continue
        if view is not None:
            found.append(view)
    return found, lost


def _first(line: Line, records: Records) -> int | None:
    """The first run of a line that is here: of its first seed, as a rule."""
    return next((int(row["run"]) for row in line.runs if int(row["run"]) in records.runs), None)


def _view(place: str, runs: dict[str, int], records: Records, album: Album) -> ViewTiles | None:
    number = next(iter(runs.values()))
    rendered = sorted((records.runs[number].path / "renders").glob("*.png"))
    if not rendered:
        return None
    name, tiles = rendered[0].name, list[Tile]()

    def add(key: str, label: str, note: str, picture: Any) -> None:
        tiles.append(Tile(key, label, note, f"{label}, {place}: {note}", picture))

    capture, made_of = records.captures[number][0], records.sets[number][0]
    if (dark := capture / "images" / name).is_file():
        add("dark", "Dark input", "what the camera delivers, 8-bit sRGB", album.add_file(dark))
    truth = made_of / "images" / name
    lit = read_png(truth) if made_of != capture and truth.is_file() else None
    first = read_png(rendered[0])
    if lit is not None and lit.shape == first.shape:
        add("truth-lit", "Truth: well lit", "the scene in good light", album.add_file(truth))
    else:
        lit = None
    for method, mine in runs.items():
        _add_run(add, method, records.runs[mine], name, lit, album)
    height, width = first.shape[:2]
    title = f"{place}, view {Path(name).stem}"
    if (probe := _probe(capture, records.captures[number][1], Path(name).stem)) is None:
        return ViewTiles(title, True, width, height, tuple(tiles))
    return ViewTiles(
        title, True, width, height, tuple(tiles), probe.header, album.add_data(f"probe-{title}", probe.data)
    )


def _probe(path: Path, record: dict[str, Any], view: str) -> Probe | None:
    """The numbers of a view's pixels; None of imported photographs.

    The capture is not compared with its checksums: of a study of thousands that would read everything.
    """
    if record.get("sensor") is None or is_imported(record):
        return None
    cameras = load_set(path)
    capture = Capture(path, record, cameras, sensor_from_dict(record["sensor"]), content="")
    return probe_of(capture, cameras.names.index(view)) if view in cameras.names else None


def _add_run(add: Any, method: str, run: Run, name: str, lit: Any, album: Album) -> None:
    path = run.path / "renders" / name
    if not path.is_file():
        return
    image = read_png(path)
    add(f"render-{method}", f"Rendered by {method}", "held out", album.add_file(path))
    if lit is not None and image.shape == lit.shape:
        note = "distance to the well-lit truth after affine alignment"
        add(f"error-{method}", f"Error of {method}", note, album.add(error_map(image, lit)))
