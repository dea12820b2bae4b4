"""Claims about dark photographs: which files they are, and where they are found."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.importing.dark import Dark, _raws_beside, _with_pictures, open_dark


def dark(folder: Path) -> Dark:
    """Two views, of which each has a raw file, and points."""
    folder.mkdir()
    for name in ("transforms.json", "a.png", "b.png", "a.dng", "b.dng", "points.ply"):
        (folder / name).write_text(name)
    views = SimpleNamespace(path=folder, names=("a", "b"), files=(folder / "a.png", folder / "b.png"),
                            points_file=folder / "points.ply")  # fmt: skip
    source: Any = SimpleNamespace(views=views)
    return Dark(source, "8bit", (folder / "a.dng", folder / "b.dng"))


@pytest.mark.parametrize("name", ["a.png", "b.png", "a.dng", "b.dng", "points.ply", "transforms.json"])
def test_every_file_that_is_read_counts_and_no_other(tmp_path: Path, name: str) -> None:
    found = dark(tmp_path / "dark")
    before = found.digest()
    (tmp_path / "dark" / "notes.txt").write_text("mine")
    assert found.digest() == before
    (tmp_path / "dark" / name).write_text("another")
    assert found.digest() != before


def test_the_raw_file_of_each_view_is_found_and_one_that_is_missing_is_named(tmp_path: Path) -> None:
    names = ("a", "b", "c")
    for name in names:
        for file in (tmp_path / "images" / f"{name}.png", tmp_path / "raw" / f"{name}.dng"):
            file.parent.mkdir(exist_ok=True)
            file.touch()
    views = SimpleNamespace(path=tmp_path, names=names, files=tuple(tmp_path / "images" / f"{n}.png" for n in names))
    source: Any = SimpleNamespace(views=views)
    assert [path.name for path in _raws_beside(tmp_path, source)] == ["a.dng", "b.dng", "c.dng"]
    (tmp_path / "raw" / "c.dng").unlink()
    with pytest.raises(ValueError, match="c"):
        _raws_beside(tmp_path, source)


def test_all_folders_that_hold_pictures_are_found_and_none_inside_another(tmp_path: Path) -> None:
    for name in ("a/1.png", "b/images/2.png", "c/d/3.png", "c/e/images/4.png", "a/f/5.png", "g/notes.txt", ".h/6.png"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = [path.relative_to(tmp_path).as_posix() for path in _with_pictures(tmp_path)]
    assert found == ["a", "b", "c/d", "c/e"]


def test_a_folder_whose_pictures_lie_deeper_names_the_folders_that_hold_them(tmp_path: Path) -> None:
    above, quiet = tmp_path / "above", Console(quiet=True)
    for name in ("trip/dark/images/0.png", "trip/dark/transforms.json", "bare/images/0.png"):
        (above / name).parent.mkdir(parents=True, exist_ok=True)
        (above / name).touch()
    said = "above holds no pictures itself; pictures with cameras are in trip/dark: give that folder"
    with pytest.raises(ValueError, match=said):
        open_dark(above, None, "own", None, quiet)
    (above / "trip" / "dark" / "transforms.json").unlink()
    with pytest.raises(ValueError, match="itself; pictures are in bare, trip/dark: give one of these folders"):
        open_dark(above, None, "own", None, quiet)
