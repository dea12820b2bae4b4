"""Claims about camera raw files whose pixels are not all there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.testbed.folders.raw_files import read_digital_numbers, read_format, read_mosaic, read_radiance
from sensor_model import PRESETS, Exposure, Sensor, write_dng

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
