"""Claims about files that somebody exchanges: no command goes on with them as if nothing had happened."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

EXCHANGED = [
    # folder, file, another one of the same kind, commands that read it
    ("capture", "truth/0000.exr", "truth/0001.exr", ("reconstruct", "score", "report")),
    ("capture", "images/0000.png", "images/0001.png", ("reconstruct", "score", "report")),
    ("capture", "images16/0002.png", "images16/0001.png", ("reconstruct", "score", "report")),
    ("capture", "raw/0002.dng", "raw/0001.dng", ("reconstruct",)),
    ("set", "gt/0000.exr", "gt/0001.exr", ("capture", "score", "report")),
    ("set", "images/0000.png", "images/0001.png", ("capture", "score", "report")),
    ("run", "renders/0000.png", "renders_train/0001.png", ("score", "report")),
    ("run", "exr/0000.exr", "exr/0001.exr", ("score", "report")),
    ("run", "point_cloud.ply", "cameras.json", ("score", "report")),
]
CASES = [(command, *case[:3]) for case in EXCHANGED for command in case[3]]


@pytest.mark.parametrize(("command", "folder", "file", "other"), CASES)
def test_an_exchanged_file_is_refused_by_name(
    server: Any, stages: dict[str, Any], begun: Callable[..., Path], command: str, folder: str, file: str, other: str
) -> None:
    place = begun(command)
    target = place / folder / file
    target.unlink()  # it is a link to the one that all tests share
    shutil.copyfile(place / folder / other, target)
    result = server.run(place, stages[command].command)
    assert result.code == 2
    assert result.line.startswith("novags: error: ")
    assert folder in result.line
    assert file in result.line
    assert "put back what was there" in result.line


@pytest.mark.parametrize("command", ["capture", "reconstruct", "score", "report"])
def test_an_equal_copy_is_not_an_exchanged_file(
    server: Any, stages: dict[str, Any], begun: Callable[..., Path], command: str
) -> None:
    """Rationale: an archive that is unpacked elsewhere has the same files with other times."""
    place = begun(command)
    for folder in stages[command].needs:
        shutil.move(place / folder, place / "moved")
        shutil.copytree(place / "moved", place / folder, copy_function=shutil.copyfile)
        shutil.rmtree(place / "moved")
    assert server.run(place, stages[command].command).code == 0
