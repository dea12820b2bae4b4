"""The pictures of a study: of every place one held-out view, with all that the page of a single run shows of it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from novags.testbed.console import Console, warnings_as_notes
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.report.look.album import Album
from novags.testbed.report.material import Material
from novags.testbed.report.pictures import ViewTiles, view_tiles
from novags.testbed.report.study.grid import Line, by_place
from novags.testbed.report.study.records import Records
from novags.testbed.study.grid import spelled

QUIET = Console(quiet=True)


def study_views(
    lines: Sequence[Line], records: Records, album: Album
) -> tuple[dict[str, ViewTiles], dict[str, str]]:  # fmt: skip
    """The pictures of every place that has a finished run on this machine, and what cannot be shown with the reason."""
    found, lost = dict[str, ViewTiles](), dict[str, str]()
    opened = lru_cache(maxsize=1)(_opened)  # neighbours often share a capture, with all that was computed from it
    for members in by_place(lines).values():
        place = place_of(members[0])
        capture, runs = chosen(members, records)
        if capture is None:
            continue
        try:
            shown = _view(place, *opened(capture), runs, records.folder, album)
        except (ValueError, OSError) as error:  # one damaged file must not cost the page of a thousand runs
            lost[place] = str(error)
            continue
        if shown is not None:
            found[place] = shown
        here = {line.method for line in members if _numbers(line, records)}
        for method in sorted(here - set(runs)):
            lost[f"{place}, {method}"] = "no finished run of it is from the same capture as the others"
    return found, lost


def place_of(line: Line) -> str:
    """What a page calls the place of a line."""
    return spelled(line.place) or "all runs"


def _numbers(line: Line, records: Records) -> list[int]:
    return [int(row["run"]) for row in line.runs if int(row["run"]) in records.runs]


def chosen(members: Sequence[Line], records: Records) -> tuple[Path | None, dict[str, Run]]:
    """The capture that most methods of a place have a run of, the first of several; and the first run of each."""
    captures = Counter[Path]()
    for line in members:
        captures.update(dict.fromkeys(records.captures[number][0] for number in _numbers(line, records)).keys())
    if not captures:
        return None, {}
    capture = max(captures, key=lambda path: captures[path])
    runs: dict[str, Run] = {}
    for line in members:
        for number in _numbers(line, records):
            if records.captures[number][0] == capture:
                runs.setdefault(line.method, records.runs[number])
    return capture, runs


def _view(
    place: str, capture: Capture, lit: Source, runs: Mapping[str, Run], folder: Path, album: Album
) -> ViewTiles | None:
    shown = [(i, here) for i in capture.cameras.test_indices if (here := _rendered(runs, capture.names[i]))]
    if not shown:
        return None
    i, mine = shown[0]
    for run in mine.values():
        run.capture()
    scores = {name: run.scores() or {"views": {}} for name, run in mine.items()}
    material = Material(folder, {}, mine, {"methods": scores}, capture, lit)
    return view_tiles(i, material, album, place)


def _rendered(runs: Mapping[str, Run], name: str) -> dict[str, Run]:
    return {method: run for method, run in runs.items() if (run.path / "renders" / f"{name}.png").is_file()}


def _opened(path: Path) -> tuple[Capture, Source]:
    """A capture and its set; where that is gone, the capture's own cameras without any truth in good light."""
    with warnings_as_notes(QUIET):  # a picture that is missing has its place in the page
        capture = open_capture(path)
    if capture.record.imported or capture.set_path is not None:
        return capture, capture.source(QUIET)
    views = replace(capture.cameras, kind="photographs", meta={})
    return capture, Source(views=views, rig=views.rig, console=QUIET, lit_known=False)
