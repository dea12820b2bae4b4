"""Claims about listed images: found however they are spelt, never taken for another, named where they lack."""

from pathlib import Path

import numpy as np
import pytest

from sensor_model.files.reading import some
from simscenes import load_set, orbit_rig
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.finding import find_file, find_files, spelt
from tests.miniatures import colmap
from tests.simscenes.sets.test_names import folder_of


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def test_a_backslash_separates_unless_a_file_is_called_so(tmp_path: Path) -> None:
    folder = touched(tmp_path, "a/b.png", "c\\d.png", "c/d.png")
    assert find_files(folder, ["a\\b.png", "a\\b", "c\\d.png", "c/d.png"]) == [
        folder / "a/b.png", folder / "a/b.png", folder / "c\\d.png", folder / "c/d.png"
    ]  # fmt: skip


def test_case_is_overlooked_where_one_file_is_left_that_nobody_else_lists(tmp_path: Path) -> None:
    folder = touched(tmp_path, "Images/A.png", "images/B.PNG", "images/c.png", "images/C.png", "images/d.png")
    listed = ["images/a.png", "IMAGES/b", "images/C.PNG", "images/D.png", "images/d.png", "../images/b.png"]
    assert find_files(folder, listed) == [
        folder / "Images/A.png", folder / "images/B.PNG", None, None, folder / "images/d.png", None
    ]  # fmt: skip
    touched(tmp_path, "Images/Other/e.png", "images/Sub/e.png")
    assert find_file(folder, "IMAGES/SUB/e.png") == folder / "images/Sub/e.png"
    assert find_file(folder, "IMAGES/OTHER/e.png") == folder / "Images/Other/e.png"
    assert find_file(folder / "images", "../iMAGES/a.png") == folder / "images/../Images/A.png"
    assert find_file(folder, "images/straße.png") is None


def test_a_picture_listed_without_its_suffix_is_found_beside_one_in_capitals(tmp_path: Path) -> None:
    folder = touched(tmp_path, "images/a.png", "images/A.png")
    assert find_file(folder, "images/a") == folder / "images/a.png"


def test_another_suffix_is_not_taken_and_is_said(tmp_path: Path) -> None:
    folder, listed = (
        touched(tmp_path, "images/a.png", "images/b.TIF", "images/c.txt"),
        ["images/a.jpg", "images\\b", "c"],
    )
    files = find_files(folder, listed)
    assert files == [None, None, None]
    assert spelt(folder, listed, files) == [
        "images/a.jpg (images/a.png is there)",
        "images\\b (images/b.TIF is there)",
        "c",
    ]


def test_pictures_in_another_folder_are_not_taken_and_are_said(tmp_path: Path) -> None:
    """Lists name the folders of the computer that they were written on."""
    folder = touched(tmp_path / "set", "images/a.png", "raw/day/b.jpg")
    touched(tmp_path, "outside/c.png")
    (folder / "link").symlink_to(tmp_path / "outside")
    listed = ["/elsewhere/set/images/a.png", "..\\frames\\b.jpg", "set/images/a.jpeg", "images/c.png"]
    files = find_files(folder, listed)
    assert files == [None] * 4
    assert spelt(folder, listed, files) == [
        "/elsewhere/set/images/a.png (images/a.png is there)",
        "..\\frames\\b.jpg (raw/day/b.jpg is there)",
        "set/images/a.jpeg (images/a.png is there)",
        "images/c.png",
    ]


def test_a_missing_picture_is_looked_for_elsewhere_though_the_first_is_there(tmp_path: Path) -> None:
    folder, there = touched(tmp_path, "a.png", "raw/b.png"), "b.png (raw/b.png is there)"
    for listed in (["a.png", "b.png", "c.png"], ["a.png", "b.png"], ["b.png", "a.png"]):
        wanted = [there if name == "b.png" else name for name in listed]
        assert spelt(folder, listed, find_files(folder, listed)) == wanted


def test_a_few_names_are_shown_on_one_line() -> None:
    assert some(["a", "b", "c"]) == "a, b, c"
    assert some(["a\nb", "c", "d", "e"]) == "'a\\nb', c, d, ..."


def test_sets_whose_files_differ_in_case_or_separators_are_whole(tmp_path: Path) -> None:
    files = [f"images/{k}.jpg" for k in range(3)]
    views = load_set(folder_of(tmp_path, files, ["images\\0.JPG", "Images/1.jpg", "images/2.jpg"]))
    assert [file.relative_to(tmp_path).as_posix() for file in views.files] == files


def test_skipped_views_are_named_with_what_is_there_instead(tmp_path: Path) -> None:
    listed = ["images/0.png", "images/1.jpg", "images/2.png", "images/3.png", "images/4.png"]
    folder = folder_of(tmp_path, [f"images/{k}.png" for k in range(5)], listed)
    for k in (2, 3, 4):
        (folder / f"images/{k}.png").unlink()
    with pytest.warns(
        UserWarning,
        match=r"4 of 5 views .* skipped: images/1.jpg \(images/1.png is there\), images/2.png, images/3.png, \.\.\.$",
    ):
        assert load_set(folder).names == ("0",)


def test_a_model_of_another_suffix_is_refused_with_the_files_that_are_there(tmp_path: Path) -> None:
    for k in range(3):
        write_png(tmp_path / "images" / f"{k}.jpg", np.zeros((24, 32, 3), np.uint8))
    colmap(tmp_path / "sparse" / "0", ["0.png", "1.png", "2.png"], orbit_rig(3, 32, 24, 50.0, radius=3.0))
    with pytest.raises(ValueError, match=r"none of the 3 images .* exists: images/0.png \(images/0.jpg is there\), "):
        load_set(tmp_path)
