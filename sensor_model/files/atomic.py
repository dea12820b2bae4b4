"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write under a temporary name, then rename; an earlier `path` is replaced only if the block succeeds.

    Args:
        path: File to write, or folder; the folder it lies in is created.

    Yields:
        A hidden name in the same folder, with the same suffix (some writers choose the format by it). The block writes
        a file there, or creates a folder and fills it. If the block raises, nothing is left behind.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.partial{target.suffix}")
    _remove(temporary)  # what a killed process of the same number may have left
    try:
        yield temporary
        if temporary.is_dir():
            _remove(target)  # a folder cannot be renamed onto one that holds files
        os.replace(temporary, target)
    finally:
        _remove(temporary)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
