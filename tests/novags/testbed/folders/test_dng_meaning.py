"""Claims about DNG files of strangers: the light is right, or the file is refused by the name of what is not done."""

import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.photographs.linear import load_linear_set, within_margins
from novags.testbed.folders.photographs.raw_files import (
    place_of,
    read_digital_numbers,
    read_format,
    read_mosaic,
    read_radiance,
    size,
    skipped_steps,
)
from novags.testbed.importing.raw_camera import raw_camera
from novags.testbed.stages.configs.importing import ImportConfig
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png
from tests.dngs import mosaic_of, write_dng

H, W = 48, 64
COLOUR = np.array([0.3, 0.1, 0.05])
LIGHT = np.broadcast_to(COLOUR, (H, W, 3))


def developed(file: Path) -> list[np.ndarray]:
    """The mean colour of the middle, by the two ways that raw files are developed."""
    camera = raw_camera(file, None, "menon")
    return [light[8:-8, 8:-8].mean((0, 1)) for light in (camera.develop(camera.codes(file)), read_radiance(file))]


def test_each_place_has_its_own_black_level(tmp_path: Path) -> None:
    """Rationale: LibRaw keeps the least level of a pattern of 4 x 4: dark colours came out a tenth too light."""
    levels = 500.0 + 8 * np.arange(16).reshape(4, 4)
    file = write_dng(tmp_path / "a.dng", mosaic_of(LIGHT, np.tile(levels, (12, 16))), {50713: ("H", [4, 4])},
                     black=levels.ravel().tolist())  # fmt: skip
    for found in developed(file):
        np.testing.assert_allclose(found, COLOUR, rtol=0.01)
    camera = raw_camera(file, None, "menon")
    for light in (camera.develop(camera.codes(file)), read_radiance(file)):
        assert light[8:-8, 8:-8].std((0, 1)).max() < 0.001


def test_a_camera_of_few_codes_counts_as_one_of_eight_bits(tmp_path: Path) -> None:
    """White at 100 fits into seven bits, of which no camera is."""
    for white, bits in ((100, 8), (255, 8), (256, 9), (4095, 12)):
        file = write_dng(tmp_path / f"{white}.dng", mosaic_of(LIGHT, np.zeros((H, W))) // 1000, black=[0], white=white)
        assert raw_camera(file, None, "menon").sensor.bits == bits


@pytest.mark.parametrize("axis", [0, 1])
def test_black_levels_that_rise_from_row_to_row_or_column_to_column_are_followed(axis: int, tmp_path: Path) -> None:
    rise = np.linspace(0, 300, (H, W)[axis])
    black = 200 + np.expand_dims(rise, 1 - axis)
    tags = {(50716, 50715)[axis]: ("S", rise.tolist())}
    file = write_dng(tmp_path / "a.dng", mosaic_of(LIGHT, black), tags, black=[200])
    camera = raw_camera(file, None, "menon")
    light = np.moveaxis(camera.develop(camera.codes(file)), axis, 0)
    for part in (light[4:12], light[-12:-4]):
        np.testing.assert_allclose(part[:, 8:-8].mean((0, 1)), COLOUR, rtol=0.025)


@pytest.mark.parametrize("margins", [(17, 43), (18, 41), (1, 2), (4, 6)])
def test_the_active_area_is_whole_whatever_its_margins(margins: tuple[int, int], tmp_path: Path) -> None:
    """Rationale: LibRaw drops a row or a column where a margin is odd, and cameras then were off by half a pixel."""
    top, left = margins
    levels = np.tile([[500.0, 520.0], [540.0, 560.0]], (H // 2, W // 2))
    codes = mosaic_of(LIGHT, levels)
    frame = np.full((H + top + 5, W + left + 7), 510.0)
    frame[top : top + H, left : left + W] = codes
    extra: Any = {50829: ("I", [top, left, top + H, left + W]), 50713: ("H", [2, 2])}
    file = write_dng(tmp_path / "a.dng", frame, extra, black=[500, 520, 540, 560])
    assert size(file) == (W, H)
    np.testing.assert_array_equal(read_digital_numbers(file), codes)
    np.testing.assert_array_equal(read_mosaic(file).dn, codes)
    stated = read_format(file)
    assert (stated.shape, stated.cfa, stated.black) == ((H, W), "RGGB", (500, 520, 540, 560))
    for found in developed(file):
        np.testing.assert_allclose(found, COLOUR, rtol=0.01)


def steps(number: int, flags: int) -> tuple[str, list[float]]:
    return "B", list(struct.pack(">5I", 1, number, 0x01030000, flags, 4) + bytes(4))


REFUSED = [
    ({51009: steps(9, 0)}, r"asks for GainMap, which undoes vignetting \(OpcodeList2\), .* must not pass over it"),
    ({51022: steps(1, 0)}, r"asks for WarpRectilinear, which undoes distortion \(OpcodeList3\)"),
    ({51008: steps(99, 0)}, r"asks for step 99, which is not known \(OpcodeList1\)"),
    ({259: ("H", [52546])}, r"is compressed by JPEG XL \(Compression 52546\), which LibRaw does not read: convert"),
    ({33421: ("H", [4, 4]), 33422: ("B", [0, 0, 1, 1] * 2 + [1, 1, 2, 2] * 2)}, "a colour filter array of 4 x 4"),
    ({50711: ("H", [2])}, r"filters that are not on a rectangular grid \(CFALayout 2\)"),
    ({50718: ("R", [1.0, 2.0])}, r"pixels that are not square \(DefaultScale 1, 2\)"),
    ({50975: ("H", [2])}, r"in another order \(RowInterleaveFactor 2\)"),
    ({50829: ("I", [0, 0, H + 1, W])}, "must have its active area inside of 64 x 48 px"),
    ({339: ("H", [3])}, r"numbers that are not codes \(SampleFormat 3\)"),
]  # fmt: skip


@pytest.mark.parametrize(("extra", "message"), REFUSED)
def test_what_is_not_done_is_refused_by_name(extra: Any, message: str, tmp_path: Path) -> None:
    file = write_dng(tmp_path / "a.dng", mosaic_of(LIGHT, 512.0), extra, black=[512])
    for read in (read_format, read_radiance, read_digital_numbers, read_mosaic):
        with pytest.raises(ValueError, match=rf"a\.dng .*{message}"):
            read(file)


def test_steps_that_readers_may_pass_over_are_said(tmp_path: Path) -> None:
    file = write_dng(tmp_path / "a.dng", mosaic_of(LIGHT, 512.0), {51009: steps(9, 1), 51008: steps(5, 0)}, black=[512])
    assert skipped_steps(file) == ("GainMap, which undoes vignetting (OpcodeList2)",)
    np.testing.assert_allclose(developed(file)[0], COLOUR, rtol=0.01)


@pytest.mark.parametrize(
    ("codes", "black", "white", "message"),
    [
        (mosaic_of(LIGHT, 512.0, block=2), 512, 16383, "probably of a Quad Bayer sensor, whose filters are 4 x 4"),
        (
            mosaic_of(LIGHT, 64.0, 1023) * 16,
            64,
            1023,
            "above 1.5 times that, .* probably shifted to the top of 16 bits",
        ),  # fmt: skip
        (mosaic_of(LIGHT, 64.0, 1023), 4096, 16383, "5% of the picture have at most .*: black is probably subtracted"),
    ],
)
def test_codes_that_do_not_fit_their_file_are_refused(
    codes: np.ndarray, black: int, white: int, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message):
        read_format(write_dng(tmp_path / "a.dng", codes, black=[black], white=white))


@pytest.mark.parametrize(("tag", "count"), [(50714, 4), (50715, W), (50716, H)])
def test_black_levels_that_are_no_numbers_are_refused(tag: int, count: int, tmp_path: Path) -> None:
    levels = {50713: ("H", [2, 2]), tag: ("F", [1.0] * (count - 1) + [np.nan])}
    with pytest.raises(ValueError, match="must state finite black levels"):
        read_format(write_dng(tmp_path / "a.dng", mosaic_of(LIGHT, 500.0), levels, black=[500] * 4))


def test_the_picture_is_where_the_crop_of_the_file_says(tmp_path: Path) -> None:
    """Rationale: poses are of the cropped picture. It was taken for the middle, which is some pixels off."""
    crop: Any = {50719: ("R", [6.0, 1.0]), 50720: ("R", [56.0, 44.0])}
    file = write_dng(tmp_path / "a.dng", mosaic_of(LIGHT, 512.0), crop, black=[512])
    assert place_of(file, (H, W), 44, 56) == (1, 6)
    assert place_of(file, (H, W), 40, 56) == (4, 4)  # of another size: the middle


WHOLE, PART = (168, 126), (160, 120)  # px: the raw file has 1.05 times as many on both sides


def stranger(folder: Path, crop: Any, name: str) -> Path:
    """A raw file and a camera for a smaller picture of the same shape."""
    write_cameras(folder, ["0000"], orbit_rig(1, *PART, 50.0, radius=3.0))
    shutil.rmtree(folder / "sparse")
    (folder / "transforms.json").write_text((folder / "transforms.json").read_text().replace("images/0000.png", name))
    light = np.full((*WHOLE[::-1], 3), 0.2) * np.linspace(0.2, 1, WHOLE[0])[:, None]
    write_dng(folder / "raw" / "0000.dng", mosaic_of(light, 512.0), crop, black=[512])
    return folder


def test_a_raw_file_larger_than_its_pictures_and_of_their_shape_is_not_cut_unless_it_says_so(tmp_path: Path) -> None:
    """Rationale: it was cut, under the focal length of the shrunk pictures."""
    focal = orbit_rig(1, *PART, 50.0, radius=3.0).Ks[0, 0, 0]
    with pytest.warns(UserWarning, match="are 168 x 126 px, 1.05 times the 160 x 120 px of their cameras"):
        shrunk = load_linear_set(stranger(tmp_path / "shrunk", {}, "raw/0000.dng"))
    crop: Any = {50719: ("R", [4.0, 3.0]), 50720: ("R", [160.0, 120.0])}
    cut = load_linear_set(stranger(tmp_path / "cut", crop, "raw/0000.dng"))
    assert shrunk is not None
    assert cut is not None
    assert (shrunk.rig.width, shrunk.rig.height) == WHOLE
    assert shrunk.rig.Ks[0, 0, 0] == pytest.approx(1.05 * focal)
    assert (cut.rig.width, cut.rig.height) == PART
    assert cut.rig.Ks[0, 0, 0] == pytest.approx(focal)


def test_margins_that_change_the_shape_or_are_small_are_cut(tmp_path: Path) -> None:
    file = write_dng(tmp_path / "a.dng", mosaic_of(LIGHT, 512.0), black=[512])
    for whole, part in (((4080, 3072), (4032, 3024)), ((6048, 4024), (6000, 4000)), ((4032, 3024), (4000, 3000))):
        assert within_margins(file, whole, part)
    for part in ((3840, 2880), (5760, 3832)):
        assert not within_margins(file, (round(1.05 * part[0]), round(1.05 * part[1])), part)


def test_a_raw_file_beside_a_shrunk_picture_is_refused(tmp_path: Path) -> None:
    folder = stranger(tmp_path / "a", {}, "images/0000.png")
    write_png(folder / "images" / "0000.png", np.full((*PART[::-1], 3), 90, np.uint8))
    wrong = r"0000\.dng must be 160 x 120 px .* got 168 x 126: the pictures with cameras are probably shrunk by 1\.05"
    with pytest.raises(ValueError, match=wrong):
        stages.import_photographs(folder, tmp_path / "cap", ImportConfig(), Console(quiet=True))
