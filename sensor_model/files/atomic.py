"""Files and folders that appear whole or not at all, and logs that grow."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from glob import escape
from pathlib import Path
from typing import BinaryIO

from sensor_model.files.door import check_links, descriptor_of_our_own, stamp_of

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
        ValueError: If a link leads its folder out of the given folders.
    """
    target = Path(path)
    check_links(target.parent)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.partial{target.suffix}")
    remove(temporary)  # files that a killed process of the same number may have left
    try:
        yield temporary
        for witness in _witnesses:
            witness.see(temporary, target)
        if temporary.is_dir():
            remove(target)  # a folder cannot be renamed onto one that holds files
        os.replace(temporary, target)
        for witness in _witnesses:
            witness.stamp(target)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror, str(target)) from error  # its name, not the hidden one or none
    finally:
        remove(temporary)


class Witness:
    """The content of files when they were written.

    Attributes:
        found: The results of `look`, by the absolute path.
        stamps: Device, inode, times and size of the same files, once they had their names.
    """

    def __init__(self, look: Callable[[Path], bytes]) -> None:
        self.look, self.found = look, dict[str, bytes]()
        self.stamps: dict[str, tuple[int, ...]] = {}

    def see(self, temporary: Path, target: Path) -> None:
        """A file, or a folder of files, is about to appear at `target`."""
        files = sorted(temporary.rglob("*")) if temporary.is_dir() else [temporary]
        for file in files:
            if file.is_file():
                self.found[os.path.abspath(target / file.relative_to(temporary))] = self.look(file)

    def stamp(self, target: Path) -> None:
        """It has appeared."""
        for file in sorted(target.rglob("*")) if target.is_dir() else [target]:
            if file.is_file():
                self.stamps[os.path.abspath(file)] = stamp_of(file)

    def unchanged(self, path: Path) -> bytes | None:
        """The result of `look` for a file that has not changed since it appeared; None if only reading it can tell."""
        place = os.path.abspath(path)
        return self.found.get(place) if self.stamps.get(place) == stamp_of(path) else None


_witnesses: list[Witness] = []


@contextmanager
def witnessed(look: Callable[[Path], bytes]) -> Iterator[Witness]:
    """While the block runs, look at every file that appears through `atomic`, before it has its name."""
    witness = Witness(look)
    _witnesses.append(witness)
    try:
        yield witness
    finally:
        _witnesses.remove(witness)


def appending(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a file of our own to write at its end; it is made if it is missing.

    It grows from now on, so that no witness knows its content.

    Raises:
        ValueError: As `descriptor_of_our_own`.
    """
    file = os.fdopen(descriptor_of_our_own(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT), "ab")
    for witness in _witnesses:
        witness.found.pop(os.path.abspath(path), None)
    return file


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text atomically."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def sweep(folder: str | os.PathLike[str], inside: Iterable[str] = (), *, own: bool = False) -> None:
    """Remove half-written files of killed processes. Call it only where nobody else writes: under the folder's lock.

    Args:
        folder: Where to look, not in the folders in it.
        inside: Folders in it that are searched to any depth; a link to one is not followed.
        own: This process has not begun to write: files with its number are of an earlier one.
    """
    roots = (root for name in inside if (root := Path(folder) / name).is_dir() and not root.is_symlink())
    for path in [*Path(folder).glob(".*.partial*"), *(path for root in roots for path in root.rglob(".*.partial*"))]:
        match = _PARTIAL.match(path.name)
        if match is None:
            continue
        process = int(match.group(1))
        if own if process == os.getpid() else not _is_alive(process):
            remove(path)


def sweep_file(path: str | os.PathLike[str]) -> None:
    """Remove half-written versions of one file that killed processes left. Call it where nobody else writes that
    file.
    """
    target = Path(path)
    for left in target.parent.glob(f".{escape(target.stem)}.*.partial{escape(target.suffix)}"):
        match = _PARTIAL.match(left.name)
        if match is not None and not _is_alive(int(match.group(1))):
            remove(left)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass  # somebody else's
    return True


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there; of a link the link alone.

    Raises:
        ValueError: If a link leads its folder out of the given folders.
        OSError: If it cannot be removed.
    """
    check_links(path.parent)
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
