"""Claims about sets and captures that were moved after something was made from them."""

from pathlib import Path

import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.place import MOVED, keep_place, place_of
from novags.testbed.folders.run import open_run
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

QUIET = Console(quiet=True)
TINY = {"scene": "cornell", "n_views": 9, "width": 24, "height": 24, "spp": 8, "points": 50, "iterations": 4}


def test_what_was_made_from_a_folder_that_moved_is_kept_and_works_again(tmp_path: Path) -> None:
    """Rationale: the same request was "unchanged, kept", and whatever read its result missed the folder for ever."""
    preset = adapted(EXPERIMENTS["demo"], **TINY, methods=("naive",))
    taken, run, config = tmp_path / "capture", tmp_path / "run", preset.reconstruct("naive")
    stages.render(tmp_path / "set", preset.render, QUIET)
    stages.capture(tmp_path / "set", taken, preset.capture, QUIET)
    stages.reconstruct(taken, run, config, QUIET)
    before = stages.score(run, QUIET)
    content = open_capture(taken).content

    (tmp_path / "set").rename(tmp_path / "other set")
    with pytest.raises(ValueError, match="put it back or capture again"):
        stages.score(run, QUIET)
    stages.capture(tmp_path / "other set", taken, preset.capture, QUIET)
    assert open_capture(taken).content == content
    assert stages.score(run, QUIET) == before

    taken.rename(tmp_path / "elsewhere")
    (tmp_path / "other set").rename(tmp_path / "set")
    with pytest.raises(ValueError, match="put it back or reconstruct again"):
        stages.score(run, QUIET)
    stages.reconstruct(tmp_path / "elsewhere", run, config, QUIET)
    assert open_run(run).inputs(QUIET)[0].path == tmp_path / "elsewhere"
    assert stages.score(run, QUIET) == before


def test_a_place_is_that_of_the_record_again_once_the_folder_is_back(tmp_path: Path) -> None:
    for name in ("out", "set", "moved"):
        (tmp_path / name).mkdir()
    keep_place(tmp_path / "out", "../set", tmp_path / "moved")
    assert place_of(tmp_path / "out", "../set") == tmp_path / "moved"
    (tmp_path / "moved").rmdir()
    assert place_of(tmp_path / "out", "../set") == tmp_path / "set"
    keep_place(tmp_path / "out", "../set", tmp_path / "set")
    assert not (tmp_path / "out" / MOVED).exists()


def test_where_inputs_lie_is_no_part_of_what_was_made_from_them(tmp_path: Path) -> None:
    """Rationale: a set that was made again under another key, and came out equal, made all runs again."""
    contents = []
    preset = adapted(EXPERIMENTS["demo"], **TINY, methods=("naive",))
    for name in ("a set", "another"):
        folder = tmp_path / name
        stages.render(folder / name, preset.render, QUIET)
        stages.capture(folder / name, folder / "capture", preset.capture, QUIET)
        contents.append(open_capture(folder / "capture").content)
    assert contents[0] == contents[1]
