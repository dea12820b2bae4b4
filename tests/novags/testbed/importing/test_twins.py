"""Claims about which picture of a folder belongs to which dark view."""

from dataclasses import replace
from pathlib import Path

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.importing.twins import Twins, twins_by_order, twins_of
from simscenes.sets.multiview import MultiviewSet, load_set
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import write_cameras
from tests.miniatures import RIG, VIEWS, lit_picture

QUIET = Console(quiet=True)


def pictures(folder: Path, names: list[str]) -> Path:
    for i, name in enumerate(names):
        write_png(folder / f"{name}.png", lit_picture(i))
    return folder


def dark_views(folder: Path, names: list[str]) -> MultiviewSet:
    pictures(folder / "images", names)
    write_cameras(folder, sorted(names, key=lambda name: f"{name}.png"), RIG)
    return load_set(folder)


def test_an_order_that_differs_between_letters_and_numbers_pairs_nothing(tmp_path: Path) -> None:
    """Rationale: by letters, 10 comes before 2, and would be the twin of the first view instead of the last."""
    dark = dark_views(tmp_path / "dark", [f"dark_{i:03d}" for i in range(VIEWS)])
    twins = pictures(tmp_path / "lit", [str(i) for i in range(2, VIEWS + 2)])
    with pytest.raises(
        ValueError, match=r"the dark view dark_000: 10 by their letters, 2 by the numbers in them; give"
    ):
        twins_of(dark, twins, "--lit", QUIET)


def test_names_that_both_count_without_zeros_are_paired_by_order(tmp_path: Path) -> None:
    """Expectation: both orders put 10 with 10."""
    dark = dark_views(tmp_path / "dark", [f"dark{i}" for i in range(2, VIEWS + 2)])
    twins = pictures(tmp_path / "lit", [f"lit-{i}" for i in range(2, VIEWS + 2)])
    found = twins_of(dark, twins, "--lit", QUIET)
    assert [file.stem.removeprefix("lit-") for file in found.files] == [n.removeprefix("dark") for n in dark.names]
    assert found.paired == "order"


def test_twins_in_another_order_or_with_another_picture_are_others(tmp_path: Path) -> None:
    folder = pictures(tmp_path, ["a", "b", "c"])
    a, b, c = (folder / f"{name}.png" for name in "abc")
    digests = [Twins(folder, files, "order").digest() for files in ((a, b), (a, b), (b, a), (a, c), (a, b, c))]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 4
    pictures(tmp_path, ["beside"])
    assert Twins(folder, (a, b), "order").digest() == digests[0]


def test_all_views_without_a_twin_are_counted_and_twins_beyond_them_are_said(tmp_path: Path) -> None:
    names = [f"{i:03d}" for i in range(VIEWS)]
    dark = dark_views(tmp_path / "dark", names)
    with pytest.raises(ValueError, match=rf"has no picture of 2 of {VIEWS} views \(004, 007\)"):
        twins_of(dark, pictures(tmp_path / "some", [n for n in names if n not in ("004", "007")]), "--lit", QUIET)
    found = twins_of(dark, pictures(tmp_path / "more", [*names, "a", "b"]), "--lit", QUIET)
    assert [file.stem for file in found.files] == names


def test_twins_that_are_paired_by_order_are_counted_over_all_dark_pictures(tmp_path: Path) -> None:
    names = [f"{i:03d}" for i in range(VIEWS)]
    dark = dark_views(tmp_path / "dark", names)
    some = replace(dark, names=dark.names[2::3], files=dark.files[2::3])
    twins = pictures(tmp_path / "lit", [f"x{i}" for i in range(VIEWS)])
    assert [file.stem for file in twins_by_order(some, twins).files] == [f"x{i}" for i in range(2, VIEWS, 3)]
    assert [file.stem for file in twins_by_order(dark, twins).files] == [f"x{i}" for i in range(VIEWS)]
    pictures(twins, ["y"])
    with pytest.raises(ValueError, match=rf"has {VIEWS + 1} pictures \(x0.png to y.png\), .* {VIEWS} \(000.png to"):
        twins_by_order(dark, twins)
