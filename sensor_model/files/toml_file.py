"""TOML files that people write."""

from __future__ import annotations

import math
import os
import sys
from typing import Any

from sensor_model.files.door import read_text
from sensor_model.files.reading import brief, reading
from sensor_model.files.records import WHOLE, check_depth

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MOST = 16 << 20  # bytes; people write these by hand


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The content of a TOML file; a byte-order mark, which editors of Windows write, is passed over.

    Raises:
        ValueError: If the file cannot be read, is not TOML, is nested too deeply, or holds a number that is nan or
            does not fit 64 bits; names it.
    """
    with reading(path, "correct it"):
        try:
            found = tomllib.loads(read_text(path, most=MOST))
        except OSError as error:
            raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
        except tomllib.TOMLDecodeError as error:
            raise ValueError(f"{path} is not a readable TOML file ({brief(error)})") from error
        check_depth(found)
        _check_numbers(found, "")
    return found


def _check_numbers(value: Any, place: str) -> None:
    """Infinity is left to the readers: it is the full well of a camera without one."""
    if isinstance(value, dict):
        for name, part in value.items():
            _check_numbers(part, f"{place}.{name}" if place else name)
    elif isinstance(value, list):
        for i, part in enumerate(value):
            _check_numbers(part, f"{place}[{i}]")
    elif isinstance(value, int) and abs(value) >= WHOLE:
        raise ValueError(f"{brief(place, 80)} must be below 2**64, got a whole number of more than 19 digits")
    elif isinstance(value, float) and math.isnan(value):
        raise ValueError(f"{brief(place, 80)} must be a number, got nan")
