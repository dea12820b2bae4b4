"""Claims about which picture of a folder belongs to which dark view."""

from pathlib import Path

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.importing.twins import Twins, twins_of
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
