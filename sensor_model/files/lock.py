"""One writer to a folder at a time, by a lock that the kernel releases when its holder ends, however it ends.

`flock` itself instead of the package filelock: that one empties the lock file whenever somebody tries to get it, so the
file cannot say who holds it.
"""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import re
import shlex
import stat
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from sensor_model.files.atomic import sweep
from sensor_model.files.door import check_links, descriptor_of_our_own

NAME = ".novags.lock"  # hidden, so that it is part of no digest and of no listing; removed on release
SIGNED = re.compile(r"'.*' \(process \d+ on .*, since .*\)")  # the content of our lock files, if there is any
COMMAND_LENGTH = 160  # characters of it in a message: one line
LOST = 1000  # times that a folder may go while it is made; more is a place where there can be none, as in /proc
_READ_ONLY = (errno.EACCES, errno.EPERM, errno.EROFS)

Tell = Callable[[str], None]

_held: set[tuple[int, int, Path]] = set()  # process, thread, lock file
_lockless: set[Path] = set()  # folders for which that was said
_waiting: ContextVar[Tell | None] = ContextVar("novags_waiting", default=None)
dry: ContextVar[bool] = ContextVar("novags_dry", default=False)  # whether nothing may be written, and so nothing held


@contextmanager
def locked(
    folder: str | os.PathLike[str],
    inside: Iterable[str] = (),
    *,
    name: str = NAME,
    wait: Tell | None = None,
    make: bool = True,
) -> Iterator[bool]:
    """Hold a folder against every other process and thread that takes the same lock.

    The thread that holds it may take it again. A process that is killed releases it, and its half-written files are
    swept when the next one begins.

    Args:
        folder: The folder to hold.
        inside: Folders in it that are swept too; the folder itself always is.
        name: Of the lock file in it. Another one than `NAME` guards less than the whole folder: nothing is swept.
        wait: Called with one line about the holder if there is one, and then waited for; None: as an enclosing `locked`
            says, else refuse.
        make: Create the folder if it is missing, and remove it again if it is empty in the end. False: a folder that is
            missing is not locked.

    Yields:
        Whether the lock is held. It is not where the folder is read-only, because then nobody can write there, nor on
        a file system without locks, which is a warning, nor while `dry` is set: then nothing is made or swept, and the
        same is refused.

    Raises:
        BlockingIOError: If somebody else holds it; says who.
        NotADirectoryError: If `folder` is a file.
        OSError: If the folder cannot be created.
        ValueError: If a link leads it out of the folders that were given, or a file of that name is not a lock file.
    """
    folder = Path(folder).absolute()
    _refuse_file(folder)
    check_links(folder)
    path = Path(os.path.realpath(folder)) / name
    me = (os.getpid(), threading.get_ident(), path)
    if me in _held:
        sweep(path.parent, inside)
        yield True
        return
    if not make and not folder.exists():
        yield False
        return
    if dry.get():
        _refuse(path, folder, wait)
        yield False
        return
    missing = [parent for parent in (path.parent, *path.parent.parents) if not parent.exists()]
    waiting = _waiting.set(wait or _waiting.get())
    fd = None
    try:
        fd = _acquire(path, folder, _waiting.get())
        if fd is not None:
            _held.add(me)
            if name == NAME:
                sweep(path.parent, inside, own=True)
        yield fd is not None
    finally:
        _waiting.reset(waiting)
        if fd is not None:
            _held.discard(me)
            _release(fd, path, me[0])
        with suppress(OSError):  # it holds something, then so do those above it
            for parent in missing:
                parent.rmdir()


def _refuse_file(folder: Path) -> None:
    """One look: between two, another process may remove an empty folder."""
    try:
        mode = folder.stat().st_mode
    except OSError:
        return
    if not stat.S_ISDIR(mode):
        raise NotADirectoryError(f"{folder} is a file, not a folder: choose another one to write to")


def _refuse(path: Path, folder: Path, wait: Tell | None) -> None:
    """Raise the errors of taking the lock, and make nothing."""
    there, missing = path.parent, None
    while True:
        try:
            there.stat()  # which raises as making it would where a file is in the way
            break
        except FileNotFoundError:
            there, missing = there.parent, there
    if missing is not None and not os.access(there, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(missing))
    try:
        fd = descriptor_of_our_own(path, os.O_RDONLY)
    except OSError:
        return
    try:
        _lock(fd, folder, wait, fcntl.LOCK_SH)
        _check_ours(fd, path)
    finally:
        os.close(fd)


def _acquire(path: Path, folder: Path, wait: Tell | None) -> int | None:
    """A descriptor that holds the lock; None where there can be none."""
    lost = 0
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            fd = _opened(path)
        except (FileNotFoundError, FileExistsError):  # its last holder has just removed a folder that was empty
            _refuse_file(path.parent)
            lost += 1
            if lost > LOST:
                raise
            continue
        if fd is None:
            return None
        try:
            if not _lock(fd, folder, wait):
                path.unlink(missing_ok=True)
                os.close(fd)
                return None
            if _is_at(fd, path):
                _check_ours(fd, path)
                _sign(fd)
                return fd
        except BaseException:
            os.close(fd)
            raise
        os.close(fd)  # the last holder removed this file when it was done: another one counts now


def _opened(path: Path) -> int | None:
    try:
        return descriptor_of_our_own(path, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        if error.errno not in _READ_ONLY:
            raise
    try:
        return descriptor_of_our_own(path, os.O_RDONLY)  # left by another user's process that was killed
    except OSError:
        return None


def _lock(fd: int, folder: Path, wait: Tell | None, how: int = fcntl.LOCK_EX) -> bool:
    """Whether the file is locked now; False where the file system has no locks."""
    try:
        try:
            fcntl.flock(fd, how | fcntl.LOCK_NB)
        except BlockingIOError:
            if wait is None:
                hint = "wait until it is done (--wait does), or choose another folder"
                raise BlockingIOError(f"{folder} is in use by {_holder(fd)}: {hint}") from None
            wait(f"waiting for {folder}, in use by {_holder(fd)}")
            fcntl.flock(fd, how)
    except BlockingIOError:
        raise
    except OSError as error:
        if folder not in _lockless:
            _lockless.add(folder)
            why = os.strerror(error.errno or 0)
            warnings.warn(
                f"{folder} lies on a file system without locks ({why}): do not let two processes write there at once",
                stacklevel=2,
            )
        return False
    return True


def _is_at(fd: int, path: Path) -> bool:
    """Whether the open file still has this name."""
    try:
        return os.path.samestat(os.fstat(fd), os.stat(path))
    except FileNotFoundError:
        return False


def _check_ours(fd: int, path: Path) -> None:
    """Refuse to write over a file that no holder of this lock has written."""
    text = os.pread(fd, 4096, 0).decode("utf-8", "replace")
    if text and not SIGNED.fullmatch(text):
        raise ValueError(f"{path} holds something else than the name of a process: move it away, it is not a lock file")


def _sign(fd: int) -> None:
    """Say in the lock file who holds it."""
    program = Path(sys.argv[0]).parent.name if sys.argv[0].endswith("__main__.py") else Path(sys.argv[0]).name
    command = " ".join(shlex.join([program or "python", *sys.argv[1:]]).split())
    if len(command) > COMMAND_LENGTH:
        command = f"{command[: COMMAND_LENGTH - 4]} ..."
    since = time.strftime("%Y-%m-%d %H:%M:%S %z")
    text = f"'{command}' (process {os.getpid()} on {platform.node()}, since {since})"
    with suppress(OSError):  # a full disk: the lock holds, only its holder has no name
        os.ftruncate(fd, 0)
        os.pwrite(fd, text.encode("utf-8", "replace"), 0)


def _holder(fd: int) -> str:
    for _ in range(5):  # it may just be signing
        if text := os.pread(fd, 4096, 0).decode("utf-8", "replace").strip():
            return text
        time.sleep(0.02)
    return "another process"


def _release(fd: int, path: Path, process: int) -> None:
    if os.getpid() == process:  # a forked child that ends must not release its parent's locks
        with suppress(OSError):
            path.unlink()
    os.close(fd)
