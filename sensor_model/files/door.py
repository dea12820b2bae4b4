"""The one door for files that come from outside: every path that is read goes through it, whoever reads the content.

A file is read if it is a regular file (a FIFO would wait for ever, a device has no end), not larger than what its kind
can need, and not reached by a link that leads out of the folder that was given: an archive can carry a link to any
file of the user's. The same rule holds for written files.

`enter` makes a folder known as one that was given: its links may lead to other places in it, to other folders that were
given, and to the places of `allow`. Paths outside all of these folders were written out by somebody in full, and links
on them are not the business of this rule. The rule is for folders that lie still, not against somebody who changes them
while they are read.
"""

from __future__ import annotations

import errno
import io
import json
import os
import stat
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import BinaryIO

AnyPath = str | os.PathLike[str]

# Bytes at most, by the kind of a file. Far above the largest that anybody has, far below a size that exhausts a
# machine.
TEXT = 256 << 20  # JSON, TOML, XML, CSV; COLMAP's text of a hundred thousand points is 50 MiB
PICTURE = 4 << 30  # 2**29 pixels of 16-bit RGB, uncompressed
POINTER = b"version https://git-lfs.github.com/spec/"  # what Git leaves in place of a large file that it did not fetch
POINTER_SIZE = 1024  # bytes that such a file has at most
VARIABLE = (
    "NOVAGS_ALLOW_LINKS"  # a list in JSON, since names can hold any other sign: how `allow` reaches child processes
)
OPTION = "--allow-links"  # of every command (`novags.commands.every`): says the same

_given: dict[str, str] = {}  # folders: absolute path as written -> without links


def enter(folder: AnyPath) -> None:
    """Take a folder as given by the user: from now on its links have to stay inside the given folders.

    Raises:
        ValueError: If it lies in another folder that was given, behind a link that leads out of all of them.
    """
    _given[os.path.abspath(folder)] = _target(folder)


def allow(places: Iterable[AnyPath]) -> None:
    """Let links lead to these folders and files, in this process and in the processes that it starts."""
    both = dict.fromkeys([*_allowed(), *(os.path.realpath(place) for place in places)])
    os.environ[VARIABLE] = json.dumps(list(both))


@contextmanager
def given(words: Iterable[str]) -> Iterator[None]:
    """While a command runs: every word of it that names something on the disk counts as given.

    Links on the way to it are the user's own, and lead where the user wants.
    """
    folders, places = dict(_given), os.environ.get(VARIABLE)
    try:
        named = [word for word in words if _is_there(word)]
        allow(named)
        for word in named:
            if os.path.isdir(word):
                enter(word)
        yield
    finally:
        _given.clear()
        _given.update(folders)
        if places is None:
            os.environ.pop(VARIABLE, None)
        else:
            os.environ[VARIABLE] = places


def _is_there(word: str) -> bool:
    try:
        return os.path.exists(word)
    except ValueError:  # a zero byte
        return False


def check_links(path: AnyPath) -> None:
    """Refuse a path in a folder that was given, if a link takes it out of all of them.

    Raises:
        ValueError: If it does, or if a link leads to itself.
    """
    _target(path)


def _target(path: AnyPath) -> str:
    """The path without links, as `check_links`."""
    absolute = os.path.abspath(path)
    target = os.path.realpath(path)  # not of `absolute`, where ".." behind a link has lost the link
    if os.path.islink(target):  # where realpath gives up
        raise ValueError(f"{path} is a link that leads to itself: remove it")
    if target == absolute or not _is_inside(absolute, _given):
        return target
    if not is_given(target):
        raise ValueError(f"{path} leads by a link to {target}, outside the folders that were given: add {OPTION} "
                         f"{os.path.dirname(target)} (in Python: {__name__}.allow) if you trust it, or put a copy "
                         "in its place")  # fmt: skip
    return target


def is_given(target: str) -> bool:
    """Whether a path without links lies in a folder that was given or allowed."""
    return _is_inside(target, reachable())


def reachable() -> list[str]:
    """Folders and files to which links may lead now: for a process of ours that was started before they were known."""
    return list(dict.fromkeys([*_given.values(), *_allowed()]))


def _allowed() -> list[str]:
    """The places given to `allow`, in this process or in one that started it."""
    found = json.loads(os.environ.get(VARIABLE) or "[]")
    return found if isinstance(found, list) else []


def resolved(path: AnyPath) -> Path:
    """The path without links.

    Raises:
        ValueError: As `check_links`.
    """
    return Path(_target(path))


def opened(path: AnyPath, *, most: int | None = None, fetched: bool = True) -> BinaryIO:
    """Open a file to read its bytes.

    Args:
        path: The file.
        most: Bytes that it may have; None: the result of `largest`.
        fetched: Whether Git's note of a file that was not fetched is refused; a hash is of what lies there.

    Raises:
        ValueError: If it is not a regular file, is larger, is Git's note of a file that was not fetched, or a link
            leads out of the given folders.
        OSError: If it is missing or cannot be read.
    """
    _check_kind(path, os.stat(path))  # before it is opened: that alone can block, or wind a tape back
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    try:
        found = os.fstat(descriptor)
        _check_kind(path, found)
        _check_size(path, found.st_size, largest() if most is None else most)
        if fetched and found.st_size < POINTER_SIZE and os.pread(descriptor, len(POINTER), 0) == POINTER:
            raise ValueError(f"{path} is not the file itself but what Git LFS puts in its place until it is fetched: "
                             "run git lfs pull there, or download the file")  # fmt: skip
        if _reached(descriptor) != os.path.abspath(path):
            check_links(path)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def stamp_of(file: AnyPath | int) -> tuple[int, ...]:
    """The stamp that changes when a file does, by its name or its descriptor: device, inode, times, size.

    A clock set back, or a copy that keeps its time stamp, can repeat the time of modification; hardly the time of
    change.

    Raises:
        OSError: If there is no such file.
    """
    found = os.stat(file)
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_ctime_ns, found.st_size


def admitted(path: AnyPath, *, most: int | None = None) -> str:
    """The same for a library that opens files by name: its name, once the file has passed. Arguments as `opened`."""
    with opened(path, most=most):
        return os.fspath(path)


def read_bytes(path: AnyPath, *, most: int = PICTURE) -> bytes:
    """All bytes of a file. Arguments and errors as for `opened`."""
    with opened(path, most=most) as file:
        return file.read()


def read_text(path: AnyPath, *, most: int = TEXT) -> str:
    """A file of UTF-8 text, without the byte-order mark that editors of Windows write; each line ends in a line feed.

    Raises:
        ValueError: As `opened`, and if it is not UTF-8.
        OSError: As `opened`.
    """
    return as_text(read_bytes(path, most=most), path)


def as_text(content: bytes, path: AnyPath) -> str:
    """Bytes of the file `path` as text, as `read_text`.

    Raises:
        ValueError: If they are not UTF-8.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not UTF-8 text (byte {error.start}): save it as UTF-8") from error
    return io.StringIO(text, newline=None).read()


def descriptor_of_our_own(path: AnyPath, flags: int) -> int:
    """`os.open` for a file under a name of ours, which somebody else may have put a link or a FIFO at.

    Raises:
        ValueError: If it is a link, anything else than a regular file, or a file with a second name: none of these was
            made by us.
        OSError: As `os.open`.
    """
    check_links(os.path.dirname(os.path.abspath(path)))
    try:
        # Not blocking: to open a FIFO would wait for its other end.
        descriptor = os.open(path, flags | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO):  # a link; a FIFO without a reader
            raise ValueError(f"{path} is not a file that novags made: remove it") from error
        raise
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:  # 0: its last holder has just removed it
        os.close(descriptor)
        raise ValueError(f"{path} is not a file that novags made: remove it")
    return descriptor


@cache
def largest() -> int:
    """Bytes of a file that this machine can make use of: half of its memory, since the content is worked on there."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2


def _check_kind(path: AnyPath, found: os.stat_result) -> None:
    if stat.S_ISREG(found.st_mode):
        return
    if stat.S_ISDIR(found.st_mode):
        raise ValueError(f"{path} must be a file, got a folder")
    kinds = {stat.S_IFIFO: "a FIFO", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket"}
    kind = kinds.get(stat.S_IFMT(found.st_mode), "something else")
    raise ValueError(f"{path} must be a regular file, got {kind}: remove it or put a copy of the file in its place")


def _check_size(path: AnyPath, size: int, most: int) -> None:
    if size > most:
        raise ValueError(f"{path} must have at most {most:,} bytes to be read here, got {size:,}: is it the right "
                         "file, and whole?")  # fmt: skip


def _reached(descriptor: int) -> str:
    """The path of an open file without links, in one call where the system tells; "" elsewhere."""
    if sys.platform == "linux":
        try:
            return os.readlink(f"/proc/self/fd/{descriptor}")
        except OSError:
            pass
    return ""


def _is_inside(path: str, folders: Iterable[str]) -> bool:
    return any(path == folder or path.startswith(folder.rstrip(os.sep) + os.sep) for folder in folders)
