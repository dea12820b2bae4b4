"""Claims about camera raw files whose pixels are not all there."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy

from novags.testbed.folders.photographs.raw_files import (
    first_colors,
    read_digital_numbers,
    read_format,
    read_mosaic,
    read_radiance,
)
from sensor_model import PRESETS, Exposure, Sensor, write_dng
from sensor_model.files.dng import XYZ_TO_SRGB
from tests.dngs import NEUTRAL, mosaic_of
from tests.dngs import write_dng as write_tags

CAMERA = PRESETS["imx900-hcg"]
SIZE = (200, 60)  # rows, columns
VALUES = ("black", "a code above black", "full below white", "white")


def frame(sensor: Sensor, channels: int | None = None) -> np.ndarray:
    """Codes with noise, well above black."""
    shape = SIZE if channels is None else (*SIZE, channels)
    noise = np.random.default_rng(0).integers(0, 200, shape)
    return (sensor.black_level + 100 + noise).astype(np.uint16)


@pytest.mark.parametrize("read", [read_format, read_mosaic, read_digital_numbers, read_radiance])
def test_a_file_that_ends_in_zeros_is_refused(read: Callable[[Path], Any], tmp_path: Path) -> None:
    """Rationale: copying that reserves the whole file and then stops leaves them, and LibRaw takes them for codes."""
    file = tmp_path / "a.dng"
    write_dng(file, frame(CAMERA), CAMERA, Exposure(time=0.01))
    whole = file.read_bytes()
    read(file)
    file.write_bytes(whole[: len(whole) * 3 // 4] + bytes(len(whole) // 4))
    with pytest.raises(ValueError, match=r"a\.dng holds no picture in the last (49|50|51) of 200 rows, .*: it is"):
        read(file)


@pytest.mark.parametrize("channels", [None, 3])
@pytest.mark.parametrize("value", VALUES)
def test_rows_that_are_black_or_white_throughout_are_a_picture(
    channels: int | None, value: str, tmp_path: Path
) -> None:
    """Rationale: skies are clipped, and where a code is worth many electrons, darkness has no noise."""
    camera = CAMERA if channels is None else PRESETS["a7s2-iso6400-3chip"]
    black = int(camera.black_level)
    codes = frame(camera, channels)
    white = int(camera.white_dn)
    codes[100:] = dict(zip(VALUES, (black, black + 1, int(0.8 * white), white), strict=True))[value]
    write_dng(tmp_path / "a.dng", codes, camera, Exposure(time=0.01))
    assert np.array_equal(read_digital_numbers(tmp_path / "a.dng"), codes)


def test_rows_that_repeat_a_pair_of_codes_are_refused_as_compressed_files_have_them(tmp_path: Path) -> None:
    codes = frame(CAMERA)
    codes[150:, ::2], codes[150:, 1::2] = 700, 900
    write_dng(tmp_path / "a.dng", codes, CAMERA, Exposure(time=0.01))
    with pytest.raises(ValueError, match="holds no picture in the last 50 of 200 rows"):
        read_digital_numbers(tmp_path / "a.dng")


def test_a_blank_sky_without_noise_is_a_picture(tmp_path: Path) -> None:
    """Simulated cameras may have none."""
    codes = frame(CAMERA)
    codes[:150] = 700
    write_dng(tmp_path / "a.dng", codes, CAMERA, Exposure(time=0.01))
    assert np.array_equal(read_digital_numbers(tmp_path / "a.dng"), codes)


def camera_file(file: Path, make: bytes, model: bytes) -> None:
    """A mosaic as most cameras write it: a TIFF that names the camera and states no colours."""
    width, height, start = 256, 128, 1024
    rows, columns = np.indices((height, width))
    dn = np.where((rows % 2 == 0) & (columns % 2 == 0), 2500, 3000) + (rows * 7 + columns * 3) % 50
    texts = (make + b"\0", model + b"\0")
    places = (512, 512 + len(texts[0]) + len(texts[0]) % 2)
    tags = [
        (256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, 16), (259, 3, 1, 1), (262, 3, 1, 32803),
        (271, 2, len(texts[0]), places[0]), (272, 2, len(texts[1]), places[1]), (273, 4, 1, start), (277, 3, 1, 1),
        (278, 4, 1, height), (279, 4, 1, 2 * width * height), (33421, 3, 2, 2 + (2 << 16)), (33422, 1, 4, 0x02010100),
    ]  # fmt: skip
    content = bytearray(start)
    head = b"II*\0" + struct.pack("<IH", 8, len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags)
    content[: len(head)] = head
    for place, text in zip(places, texts, strict=True):
        content[place : place + len(text)] = text
    file.write_bytes(bytes(content) + dn.astype("<u2").tobytes())


def test_a_file_that_states_no_colours_has_those_of_its_model(tmp_path: Path) -> None:
    """Expectation: what LibRaw itself makes of it, by its table of cameras; a matrix turns white into white."""
    camera_file(tmp_path / "a.arw", b"SONY", b"ILCE-7SM2")
    found = read_format(tmp_path / "a.arw")
    assert found.color_matrix is not None
    assert found.black == (0,) * 4
    np.testing.assert_allclose(found.color_matrix.sum(1), 1, atol=2e-3)  # XYZ_TO_SRGB has four digits
    with rawpy.imread(str(tmp_path / "a.arw")) as raw:
        kind = rawpy.ColorSpace
        in_camera, in_srgb = (raw.postprocess(
            gamma=(1, 1), no_auto_bright=True, adjust_maximum_thr=0.0, user_wb=[1.0, 1.0, 1.0, 1.0], output_bps=16,
            half_size=True, highlight_mode=rawpy.HighlightMode.Clip, output_color=space,
        ).astype(np.float64).mean((0, 1)) for space in (kind.raw, kind.sRGB))  # fmt: skip
    np.testing.assert_allclose(found.color_matrix @ in_camera, in_srgb, rtol=5e-3)
    camera_file(tmp_path / "b.arw", b"Nobody", b"Nothing")
    assert read_format(tmp_path / "b.arw").color_matrix is None


def test_light_without_a_stated_balance_is_not_made_grey_picture_by_picture(tmp_path: Path) -> None:
    """Rationale: LibRaw balances each picture by its own mean then, and the views of a set no longer agree."""
    plain = Sensor(gain=1.0, eta=1.0, mu_e_sat=10_000, black_level=100, bits=14, cfa="RGGB")
    rows, columns = np.indices((64, 64)) % 2
    for name, rgb in (("red", (4000, 1000, 1000)), ("blue", (1000, 1000, 4000))):
        file = tmp_path / f"{name}.dng"
        dn = 100 + np.asarray(rgb)[rows + columns] + np.random.default_rng(0).integers(0, 20, (64, 64))
        write_dng(file, dn.astype(np.uint16), plain, Exposure(time=0.1))
        balance, private = (struct.pack("<HH", tag, 5) for tag in (50728, 65000))  # AsShotNeutral, rationals
        assert file.read_bytes().count(balance) == 1
        file.write_bytes(file.read_bytes().replace(balance, private))
    with rawpy.imread(str(tmp_path / "red.dng")) as raw:
        assert min(raw.camera_whitebalance[:3]) <= 0  # the file states none
    red, blue = (read_radiance(tmp_path / f"{name}.dng").mean((0, 1)) for name in ("red", "blue"))
    assert red[0] > 3 * red[2]
    assert blue[2] > 3 * blue[0]


@pytest.mark.parametrize("channels", [None, 3])
def test_a_file_states_the_black_of_each_filter_and_its_own_white(channels: int | None, tmp_path: Path) -> None:
    camera = CAMERA if channels is None else PRESETS["a7s2-iso6400-3chip"]
    write_dng(tmp_path / "a.dng", frame(camera, channels), camera, Exposure(time=0.01))
    found = read_format(tmp_path / "a.dng")
    assert found.black == (camera.black_level,) * (channels or 4)
    assert found.white == int(camera.white_dn) > camera.black_level


@pytest.mark.parametrize("brighter", [1.0, 7.0])
def test_raw_colours_that_are_developed_here_go_through_the_matrix_of_the_file(brighter: float, tmp_path: Path) -> None:
    """Four black levels, which LibRaw would take for one, and a matrix that is not its own transpose. A channel that is
    clipped has no more light than white.
    """
    matrix = np.array([[1.6, -0.5, -0.1], [-0.2, 1.5, -0.3], [0.1, -0.6, 1.5]])
    levels = [500.0, 520.0, 540.0, 560.0]
    seen = brighter * (np.linalg.inv(matrix) @ [0.3, 0.1, 0.05])
    color = np.clip(matrix @ np.minimum(seen, 1.0), 0, 1)
    codes = mosaic_of(np.broadcast_to(seen, (48, 64, 3)), np.tile(np.reshape(levels, (2, 2)), (24, 32)))
    to_camera = NEUTRAL[:, None] * (np.linalg.inv(matrix) @ XYZ_TO_SRGB)
    extra: Any = {50713: ("H", [2, 2]), 50721: ("S", to_camera.ravel().tolist())}
    file = write_tags(tmp_path / "a.dng", codes, extra, black=levels)
    stated = read_format(file)
    assert stated.color_matrix is not None
    assert stated.black == tuple(levels)
    np.testing.assert_allclose(stated.color_matrix, matrix, atol=5e-3)
    np.testing.assert_allclose(read_radiance(file)[8:-8, 8:-8].mean((0, 1)), color, rtol=0.02)


def test_codes_are_compared_with_the_least_of_the_stated_black_levels(tmp_path: Path) -> None:
    levels = np.array([[500.0, 500.0], [500.0, 4000.0]])
    codes = mosaic_of(np.full((48, 64, 3), 0.01), np.tile(levels, (24, 32)))
    file = write_tags(tmp_path / "a.dng", codes, {50713: ("H", [2, 2])}, black=levels.ravel().tolist())
    np.testing.assert_array_equal(read_digital_numbers(file), codes)
    wrong = write_tags(tmp_path / "b.dng", codes - 480, {50713: ("H", [2, 2])}, black=[4000.0] * 4)
    with pytest.raises(ValueError, match="black is probably subtracted already"):
        read_digital_numbers(wrong)


def test_a_black_level_above_the_dark_parts_of_a_picture_is_refused_and_noise_around_it_is_not(tmp_path: Path) -> None:
    """Half of the picture is bright: it is the other half that tells."""
    light = np.full((64, 96, 3), 0.3)
    light[:, :48] = 0.02
    file = write_tags(tmp_path / "a.dng", mosaic_of(light, 512), black=[1500.0])
    with pytest.raises(ValueError, match="black level 1500, and 5% of the picture have at most .* subtracted already"):
        read_digital_numbers(file)
    noisy = np.random.default_rng(0).normal(1500, 400, (64, 96)).clip(0)
    np.testing.assert_array_equal(
        read_digital_numbers(write_tags(tmp_path / "b.dng", np.round(noisy), black=[1500.0])), np.round(noisy)
    )


@pytest.mark.parametrize("beside", [(0, 1), (1, 0)], ids=["a column", "a row"])
def test_filters_that_lie_a_row_or_a_column_beside_are_refused(beside: tuple[int, int], tmp_path: Path) -> None:
    """Magenta and green things alike: what red and blue show is the same, and what both places of green show is not."""
    light = np.full((64, 96, 3), 0.2) * np.linspace(0.2, 1, 96)[:, None]
    right = mosaic_of(light, 512)
    np.testing.assert_array_equal(read_digital_numbers(write_tags(tmp_path / "a.dng", right, black=[512.0])), right)
    moved = write_tags(tmp_path / "b.dng", np.roll(right, beside, (0, 1)), black=[512.0])
    with pytest.raises(ValueError, match="states the filters RGGB, .* they lie a row or a column beside"):
        read_digital_numbers(moved)


@pytest.mark.parametrize("size", [(63, 96), (64, 79), (63, 79)])
def test_a_raw_file_of_an_odd_side_is_read(size: tuple[int, int], tmp_path: Path) -> None:
    """Rationale: one place of green then has a row or a column of blocks more than the other."""
    codes = mosaic_of(np.full((64, 96, 3), 0.2) * np.linspace(0.2, 1, 96)[:, None], 512)[: size[0], : size[1]]
    np.testing.assert_array_equal(read_digital_numbers(write_tags(tmp_path / "a.dng", codes, black=[512.0])), codes)


def test_the_first_raw_file_has_the_colours_of_all_whatever_stands_before_it(tmp_path: Path) -> None:
    files = [tmp_path / f"{i}.dng" for i in range(3)]
    for file, red in zip(files, (0.5, 0.6, 0.7), strict=True):
        write_tags(file, mosaic_of(np.full((24, 32, 3), 0.2), 512), {50728: ("R", [red, 1.0, 0.7])}, black=[512.0])
    for before in ([], [tmp_path / "a.exr", tmp_path / "b.exr"]):
        found = first_colors([*before, *files])
        assert found is not None
        assert found.response[0] == pytest.approx(0.5, abs=1e-4)
    assert first_colors([tmp_path / "a.exr"]) is None
