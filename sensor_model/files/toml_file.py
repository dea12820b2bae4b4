"""TOML files that people write."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from sensor_model.files.reading import reading

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The content of a TOML file; a byte-order mark, which editors of Windows write, is passed over.

    Raises:
        ValueError: If the file cannot be read or is not TOML; names it.
    """
    with reading(path, "correct it"):
        try:
            return tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
        except OSError as error:
            raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
        except tomllib.TOMLDecodeError as error:
            raise ValueError(f"{path} is not a readable TOML file ({error})") from error
