"""Temporary folders: the next process that needs one removes the leftovers of killed processes."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

YOUNG = 60.0  # s; a folder that was made just now may not be locked yet


@contextmanager
def scratch(purpose: str) -> Iterator[Path]:
    """A folder of this process alone, in the system's place for temporary files; removed afterwards.

    It is locked while it is in use, so that leftovers of a killed process are known, in another container too.

    Args:
        purpose: Part of its name.
    """
    prefix = f"novags-{purpose}-"
    for left in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        with suppress(OSError):  # somebody else's, in use, or another process was faster
            if time.time() - left.lstat().st_mtime > YOUNG and left.lstat().st_uid == os.getuid():
                _remove_if_free(left)
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    fd = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # no locks there: then nobody can take the lock to remove it either
            fcntl.flock(fd, fcntl.LOCK_EX)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(fd)


def _remove_if_free(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)  # to open a FIFO would wait for ever
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder)
    finally:
        os.close(fd)
