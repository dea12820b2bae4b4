"""Claims about doubts in pictures of other programs: said where another reading fits far better, and else not."""

from pathlib import Path

import numpy as np
import pytest

from novags.testbed.importing.pictures import ForeignPicture, find_renders, read_picture
from novags.testbed.stages.scores.doubts import Doubts
from sensor_model import srgb_to_linear
from simscenes.sets.pictures.png import write_png

RNG = np.random.default_rng(0)
LIT = RNG.uniform(0.1, 0.9, (24, 32, 3)).astype(np.float32)
Z = RNG.uniform(2, 3, (24, 32)).astype(np.float32)
K = np.array([[30.0, 0, 16], [0, 30, 12], [0, 0, 1]])
NOISE = RNG.normal(0, 0.05, LIT.shape).astype(np.float32)


def notes(values: np.ndarray, kind: str, *, linear: bool = False) -> list[str]:
    doubts = Doubts()
    doubts.add(ForeignPicture(values.astype(np.float32), kind), LIT, linear=linear)  # type: ignore[arg-type]
    return doubts.notes("lit")


@pytest.mark.parametrize("kind", ["EXR", "16-bit"])
def test_linear_light_against_an_encoded_reference_is_said(kind: str) -> None:
    (note,) = notes(srgb_to_linear(LIT) + 0.2 * NOISE, kind)
    assert "fit the reference lit, which is sRGB-encoded, far better as linear light" in note


def test_pictures_that_are_meant_as_they_are_read_raise_no_doubt() -> None:
    assert (
        notes(LIT, "EXR")
        == notes(LIT + NOISE, "16-bit")
        == notes(0.6 * LIT, "EXR")
        == notes(LIT + NOISE, "8-bit")
        == []
    )
    assert notes(srgb_to_linear(LIT), "EXR", linear=True) == []
    assert notes(RNG.uniform(0, 1, LIT.shape), "EXR") == []


def test_grey_pictures_of_coloured_views_are_said() -> None:
    (note,) = notes(np.repeat(LIT[..., 1:2], 3, -1), "8-bit")
    assert "these pictures are grey and the views are not" in note


def test_exchanged_colours_are_said() -> None:
    (note,) = notes(LIT[..., ::-1] + NOISE, "8-bit")
    assert "far better with red and blue exchanged" in note
    grey = np.repeat(LIT[..., 1:2], 3, -1)
    assert not any("exchanged" in said for said in notes(grey, "8-bit"))


def test_transparent_pixels_are_said(tmp_path: Path) -> None:
    opaque, clear = np.dstack([LIT, np.ones(LIT.shape[:2])]), np.dstack([LIT, np.full(LIT.shape[:2], 0.9)])
    for name, pixels, said in (("a", opaque, []), ("b", clear, ["pixels of these pictures are transparent"])):
        write_png(tmp_path / f"{name}.png", pixels)
        doubts = Doubts()
        doubts.add(read_picture(tmp_path / f"{name}.png", 32, 24), LIT, linear=False)
        assert [note[:40] for note in doubts.notes("lit")] == said


def test_a_distance_in_the_channel_of_depth_is_said() -> None:
    v, u = np.mgrid[0.5:24, 0.5:32]
    longer = np.sqrt(((u - 16) / 30) ** 2 + ((v - 12) / 30) ** 2 + 1)
    for depth, said in ((Z, 0), (Z * longer, 1), (Z * RNG.uniform(0.9, 1.1, Z.shape), 0), (np.full_like(Z, np.inf), 0)):
        doubts = Doubts()
        doubts.add_depth(np.asarray(depth, np.float32), np.where(u < 3, np.inf, Z), K)
        assert [("fits far better as distance" in note) for note in doubts.notes("linear")] == [True] * said


def test_pictures_in_a_folder_below_are_named(tmp_path: Path) -> None:
    write_png(tmp_path / "rgb" / "0000.png", LIT)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="it holds no pictures itself, pictures are in rgb: give such a folder"):
        find_renders(tmp_path, ["0000"])
