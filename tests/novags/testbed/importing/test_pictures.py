"""Claims about pictures of other programs: each view has one, and what is wrong is named."""

from pathlib import Path

import numpy as np
import pytest

from novags.testbed.importing.pictures import find_renders, read_picture
from sensor_model import linear_to_srgb, srgb_to_linear
from simscenes.sets.pictures.exr import write_exr
from simscenes.sets.pictures.png import write_png
from tests.simscenes.sets.test_meaning import CODES, GAMMA, SRGB, png

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


@pytest.mark.parametrize("place", [(0, 2), (3, 5)])
@pytest.mark.parametrize("channel", ["R", "G", "B", "alpha", "A"])
def test_a_value_that_is_not_finite_is_refused_in_every_channel_and_row(
    tmp_path: Path, channel: str, place: tuple[int, int]
) -> None:
    planes = {name: np.full((4, 6), 0.5, np.float32) for name in ("R", "G", "B", "Z", "alpha")}
    planes["A"] = np.ones((4, 6), np.float32)
    write_exr(tmp_path / "a.exr", planes)
    found = read_picture(tmp_path / "a.exr", 6, 4)
    assert found.values.shape == (4, 6, 3)
    planes[channel][place] = np.nan
    write_exr(tmp_path / "a.exr", planes)
    with pytest.raises(ValueError, match="is not finite"):
        read_picture(tmp_path / "a.exr", 6, 4)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("stated", ["", "srgb", "linear"])
def test_16_bits_are_what_is_asked_for_unless_their_file_says_otherwise(
    stated: str, linear: bool, tmp_path: Path
) -> None:
    file = png(tmp_path / "a.png", CODES, *{"srgb": [SRGB], "linear": [GAMMA[1.0]]}.get(stated, []))
    shares, height, width = CODES / 65535, *CODES.shape[:2]
    other = {"srgb": srgb_to_linear(shares), "linear": linear_to_srgb(shares)}.get(stated, shares)
    wanted = shares if linear == (stated == "linear") else other
    np.testing.assert_allclose(read_picture(file, width, height, linear=linear).values, wanted, atol=1e-6)


def test_transparent_pixels_of_an_exr_file_are_before_white_as_those_of_a_png(tmp_path: Path) -> None:
    codes = np.random.default_rng(0).integers(0, 256, (4, 6, 4)).astype(np.uint8)
    codes[..., 3] |= 0xE0  # a little transparent
    write_png(tmp_path / "a.png", codes)
    shares = (codes / 255).astype(np.float32)
    planes = {c: np.ascontiguousarray(shares[..., k] * shares[..., 3]) for k, c in enumerate("RGB")}
    write_exr(tmp_path / "a.exr", {**planes, "A": np.ascontiguousarray(shares[..., 3])})
    drawn, exr = (read_picture(tmp_path / f"a.{suffix}", 6, 4) for suffix in ("png", "exr"))
    assert (drawn.clear, exr.clear) == (True, True)
    np.testing.assert_allclose(exr.values, drawn.values, atol=1e-6)
    with pytest.raises(ValueError, match=r"a\.exr must be opaque, got \d+ of 24 pixels with A below 1"):
        read_picture(tmp_path / "a.exr", 6, 4, linear=True)


@pytest.mark.parametrize(("name", "opacity"), [("A", 1.0), ("A", 0.9995), ("alpha", 0.5)])
@pytest.mark.parametrize("linear", [False, True])
def test_opaque_pixels_and_opacity_beside_depth_change_no_colour(
    name: str, opacity: float, linear: bool, tmp_path: Path
) -> None:
    planes = {c: np.full((4, 6), 0.25, np.float32) for c in "RGBZ"}
    write_exr(tmp_path / "a.exr", {**planes, name: np.full((4, 6), opacity, np.float32)})
    found = read_picture(tmp_path / "a.exr", 6, 4, linear=linear)
    assert not found.clear
    np.testing.assert_array_equal(found.values, 0.25)
    np.testing.assert_array_equal(found.alpha, np.float32(opacity))
