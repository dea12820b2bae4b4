"""Claims about pictures of other programs: each view has one, and what is wrong is named."""

from pathlib import Path

import numpy as np
import pytest

from novags.testbed.importing.pictures import find_renders, read_picture
from simscenes.sets.pictures.exr import write_exr

NAMES = ("a", "b", "c")


def test_every_view_has_its_picture_and_all_others_are_told(tmp_path: Path) -> None:
    for name in ("a.png", "b.exr", "c.JPG", "d.png", "e.png", "e.jpg", "notes.txt", ".a.jpg"):
        (tmp_path / name).touch()
    found = find_renders(tmp_path, NAMES)
    assert {name: file.name for name, file in found.files.items()} == {"a": "a.png", "b": "b.exr", "c": "c.JPG"}
    assert sorted(found.ignored) == ["d.png", "e.jpg", "e.png"]


@pytest.mark.parametrize("wrong", NAMES)
def test_a_view_without_a_picture_or_with_two_is_named_whichever_it_is(tmp_path: Path, wrong: str) -> None:
    for name in NAMES:
        (tmp_path / f"{name}.png").touch()
    (tmp_path / f"{wrong}.jpg").touch()
    with pytest.raises(ValueError, match=f"more than one picture of view {wrong}"):
        find_renders(tmp_path, NAMES)
    for suffix in ("png", "jpg"):
        (tmp_path / f"{wrong}.{suffix}").unlink()
    with pytest.raises(ValueError, match=f"lacks 1 of the 3 test views: {wrong}; it holds"):
        find_renders(tmp_path, NAMES)


def test_all_folders_that_hold_pictures_are_named_where_none_lies_above_them(tmp_path: Path) -> None:
    for name in ("rgb/a.png", "test/a.exr", "logs/a.txt", ".git/a.png"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    with pytest.raises(ValueError, match="it holds no pictures itself, pictures are in rgb, test: give such a folder"):
        find_renders(tmp_path, NAMES)


@pytest.mark.parametrize("channel", ["R", "G", "B", "alpha"])
def test_a_value_that_is_not_finite_is_refused_in_every_channel(tmp_path: Path, channel: str) -> None:
    planes = {name: np.full((4, 6), 0.5, np.float32) for name in ("R", "G", "B", "Z", "alpha")}
    write_exr(tmp_path / "a.exr", planes)
    found = read_picture(tmp_path / "a.exr", 6, 4)
    assert found.values.shape == (4, 6, 3)
    planes[channel][1, 2] = np.nan
    write_exr(tmp_path / "a.exr", planes)
    with pytest.raises(ValueError, match="is not finite"):
        read_picture(tmp_path / "a.exr", 6, 4)
