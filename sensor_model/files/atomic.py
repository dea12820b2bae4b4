"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from glob import escape
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

    Raises:
        OSError: If it cannot be written; names `path` where the system names no file.
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
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror, str(target)) from error  # its name, not the hidden one or none
    finally:
        _remove(temporary)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text atomically."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def sweep(folder: str | os.PathLike[str], inside: Iterable[str] = (), *, own: bool = False) -> None:
    """Remove what killed processes left half-written. Call it only where nobody else writes: under the folder's lock.

    Args:
        folder: Where to look, not in the folders in it.
        inside: Folders in it that are searched to any depth.
        own: This process has not begun to write: what bears its number is of an earlier one.
    """
    roots = (root for name in inside if (root := Path(folder) / name).is_dir())
    for path in [*Path(folder).glob(".*.partial*"), *(path for root in roots for path in root.rglob(".*.partial*"))]:
        match = _PARTIAL.match(path.name)
        if match is None:
            continue
        process = int(match.group(1))
        if own if process == os.getpid() else not _is_alive(process):
            _remove(path)


def sweep_file(path: str | os.PathLike[str]) -> None:
    """Remove what killed processes left half-written of one file. Call it where nobody else writes that file."""
    target = Path(path)
    for left in target.parent.glob(f".{escape(target.stem)}.*.partial{escape(target.suffix)}"):
        match = _PARTIAL.match(left.name)
        if match is not None and not _is_alive(int(match.group(1))):
            _remove(left)


def _is_alive(process: int) -> bool:
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
