"""The pictures of a study: of every place one held-out view, dark, in good light, and as each method renders it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from novags.methods.problem import encode
from novags.testbed.folders.run import Run
from novags.testbed.report.look.album import Album
from novags.testbed.report.look.maps import error_map
from novags.testbed.report.pictures import Tile, ViewTiles
from novags.testbed.report.study.grid import Line, by_place
from novags.testbed.report.study.records import Records
from novags.testbed.study.grid import spelled
from simscenes.sets.pictures.png import read_png


def study_views(lines: Sequence[Line], records: Records, album: Album) -> list[ViewTiles]:
    """The pictures of every place that has a finished run on this machine."""
    found = []
    for members in by_place(lines).values():
        runs = {line.method: number for line in members if (number := _first(line, records)) is not None}
        if runs and (view := _view(spelled(members[0].place) or "all runs", runs, records, album)) is not None:
            found.append(view)
    return found


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
    return ViewTiles(f"{place}, view {Path(name).stem}", True, width, height, tuple(tiles))


def _add_run(add: Any, method: str, run: Run, name: str, lit: Any, album: Album) -> None:
    path = run.path / "renders" / name
    if not path.is_file():
        return
    if run.space == "linear":
        image = encode(read_png(path))
        add(f"render-{method}", f"Rendered by {method}", "held out", album.add(image))
    else:
        image = read_png(path)
        add(f"render-{method}", f"Rendered by {method}", "held out", album.add_file(path))
    if lit is not None and image.shape == lit.shape:
        note = "distance to the well-lit truth after affine alignment"
        add(f"error-{method}", f"Error of {method}", note, album.add(error_map(image, lit)))
