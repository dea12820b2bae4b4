"""Camera raw files (DNG, NEF, CR2, ARW ...) through LibRaw: the mosaic as it was read out, or developed linear RGB."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sensor_model.files.dng import SMALLEST
from sensor_model.params import CFAS, Cfa

SUFFIXES = (".dng", ".nef", ".nrw", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")


def is_raw(path: Path) -> bool:
    """Whether the file's name says that it is a camera raw file."""
    return path.suffix.lower() in SUFFIXES


@dataclass(frozen=True)
class Mosaic:
    """One frame as the sensor read it out."""

    dn: np.ndarray  # uint16 [h,w]
    cfa: Cfa | None  # None: monochrome
    time: float | None  # s; None: not in the file
    bits: int  # that hold the white level


def read_mosaic(path: Path) -> Mosaic:
    """The codes of a raw file, without any processing.

    Raises:
        ValueError: If the file cannot be read, or is neither monochrome nor a Bayer mosaic.
    """
    with _opened(path) as raw:
        dn = raw.raw_image_visible
        if dn is None or dn.ndim != 2:
            raise ValueError(f"{path} holds no mosaic of the sensor's own pixels: give unprocessed raw files")
        shutter = raw.other.shutter_speed if hasattr(raw, "other") else 0.0
        time = float(f"{shutter:.6g}") if shutter > 0 else None  # LibRaw keeps it in float32
        return Mosaic(np.array(dn), _pattern(raw, path), time, int(raw.white_level).bit_length())


def read_digital_numbers(path: Path) -> np.ndarray:
    """The codes of a raw file, uint16: [h,w] of a mosaic or a monochrome sensor, [h,w,3] of three chips.

    Raises:
        ValueError: If the file cannot be read.
    """
    with _opened(path) as raw:
        dn = np.array(raw.raw_image_visible)
        return dn if dn.ndim == 2 else np.ascontiguousarray(dn[..., :3])


def _pattern(raw: Any, path: Path) -> Cfa | None:
    if raw.num_colors == 1:
        return None
    letters = "".join(chr(raw.color_desc[i]) for i in np.ravel(raw.raw_pattern))
    found = [cfa for cfa in CFAS if cfa == letters]
    if not found:
        raise ValueError(
            f"{path} has the colour filter array {letters!r}; supported are monochrome and {', '.join(CFAS)}"
        )
    return found[0]


def read_radiance(path: Path) -> np.ndarray:
    """Linear sRGB float32 [h,w,3], 1 = white level: black level, camera white balance, AHD demosaicing, colour matrix.

    Pixels stay as stored (no rotation), because poses refer to the stored pixels.

    Raises:
        ValueError: If the file cannot be read.
    """
    with _opened(path) as raw:
        codes = raw.postprocess(
            gamma=(1, 1), no_auto_bright=True, adjust_maximum_thr=0.0, use_camera_wb=True, output_bps=16, user_flip=0
        )
    return codes.astype(np.float32) / np.float32(65535)


def size(path: Path) -> tuple[int, int]:
    """Width and height of what `read_radiance` returns, from the header alone.

    Raises:
        ValueError: If the file cannot be read.
    """
    with _opened(path, pixels=False) as raw:
        return raw.sizes.width, raw.sizes.height


@contextmanager
def _opened(path: Path, *, pixels: bool = True) -> Iterator[Any]:
    import rawpy

    try:
        with rawpy.RawPy() as raw:
            raw.open_file(str(path))
            if pixels:
                raw.unpack()
            yield raw
    except (rawpy.LibRawError, OSError) as error:
        raise ValueError(
            f"{path} is not a readable raw file ({error}); replace or remove it. LibRaw also refuses images under "
            f"{SMALLEST} px wide or high"
        ) from error
