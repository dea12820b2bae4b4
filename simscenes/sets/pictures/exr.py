"""OpenEXR in and out: one file, named channels, each with its own number type."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.atomic import atomic
from sensor_model.files.door import PICTURE, admitted
from sensor_model.files.reading import brief

_DTYPES = (np.float16, np.float32, np.uint32)


def write_exr(path: str | Path, channels: dict[str, NDArray[Any]], header: dict[str, Any] | None = None) -> None:
    """Write named channels [h,w] to one scan-line EXR file, losslessly and atomically.

    Args:
        path: File to write; its folder is created.
        channels: Name (`R`, `N.X`, ...) -> [h,w] of float16, float32 or uint32; the type is kept per channel.
        header: Extra attributes: str, int, float or float matrices [4,4].

    Raises:
        ValueError: If `channels` is empty, shapes differ, EXR cannot hold a type, or a float16 channel has overflowed
            to inf.
        OSError: If the file cannot be written.
    """
    import OpenEXR

    path = Path(path)
    shapes = {np.shape(a) for a in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2 or 0 in next(iter(shapes)):
        raise ValueError(
            f"write_exr: channels must be non-empty [h,w] of one shape, got {sorted(shapes)} for {path.name}"
        )
    for name, a in channels.items():
        if a.dtype not in _DTYPES:
            raise ValueError(f"write_exr: channel {name!r} of {path.name} must be float16, float32 or uint32, got "
                             f"{a.dtype}; convert it")  # fmt: skip
        if a.dtype == np.float16 and not np.isfinite(a).all():
            raise ValueError(f"write_exr: channel {name!r} of {path.name} left the range of float16 (65504) or is not "
                             "finite; store it as float32")  # fmt: skip
    attributes = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(header or {})}
    # OpenEXR.File replaces the arrays inside the dict it is given, so it gets its own.
    own = {name: np.ascontiguousarray(a) for name, a in channels.items()}
    try:
        with atomic(path) as temporary, OpenEXR.File(attributes, own) as file:
            file.write(str(temporary))
    except RuntimeError as error:  # how it reports the system's own errors, a full disk for example
        raise OSError(f"cannot write {path}: {error}") from error


def read_exr(path: str | Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read an EXR file: channels by name, each [h,w] in its stored type, and the header attributes.

    Raises:
        ValueError: If the file is missing or is not a readable EXR file.
    """
    import OpenEXR

    path = Path(path)
    if not path.is_file():
        raise ValueError(f"read_exr: no such file: {path}")
    try:
        with OpenEXR.File(admitted(path, most=PICTURE), separate_channels=True) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
            header = dict(file.header())
    except Exception as error:  # OpenEXR raises RuntimeError, TypeError or OSError, depending on where the file is cut
        raise ValueError(
            f"read_exr: {path} is not a readable EXR file ({brief(error)}); delete it and write it again"
        ) from error
    return channels, header
