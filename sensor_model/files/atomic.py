"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

_PARTIAL = re.compile(r"\..*\.(\d+)\.partial")  # the beginning of a temporary name, with the number of its process


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


def sweep(folder: str | os.PathLike[str], names: Iterable[str] = ()) -> None:
    """Remove what killed processes left half-written. Call it only where nobody else writes: under the folder's lock.

    Args:
        folder: Where to look, not in the folders inside it.
        names: Folders inside it that are searched to any depth.
    """
    roots = (root for name in names if (root := Path(folder) / name).is_dir())
    for path in [*Path(folder).glob(".*.partial*"), *(path for root in roots for path in root.rglob(".*.partial*"))]:
        match = _PARTIAL.match(path.name)
        if match is not None and not _is_at_work(int(match.group(1))):
            _remove(path)


def _is_at_work(process: int) -> bool:
    """Whether another process of that number lives; this one has just begun, so what bears its number is older."""
    if process == os.getpid():
        return False
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass  # somebody else's
    return True


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
