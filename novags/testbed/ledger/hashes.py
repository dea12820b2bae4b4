"""Hashes of files, remembered as git does it: a file with the size, inode and times of before is not read again.

They lie in a data base in a folder that this user alone writes. A file that was changed within the last two seconds is
not remembered: it may change again without its time stamps showing it. `VERIFY` in the environment makes every file be
read.
"""

import hashlib
import os
import sqlite3
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

from sensor_model.files.door import stamp_of
from sensor_model.files.own import cache_folder, own_folder
from sensor_model.files.records import read_already

VERIFY = "NOVAGS_VERIFY"  # set by --verify of every command; processes that it starts inherit it
SETTLED = 2_000_000_000  # ns
MOST = 1_000_000  # files; beyond them all is forgotten

Stamp = tuple[object, ...]


def remembered(path: Path, read: Callable[[Path], bytes], how: str) -> bytes:
    """The hash of a file.

    Args:
        path: The file.
        read: Computes it.
        how: Names the way in which it is computed.

    Raises:
        OSError: If there is no such file, or it cannot be read.
    """
    known = read_already(path)  # whose bytes are hashed: the stamp has to be theirs, though another file may lie there
    times = stamp_of(path) if known is None else known.stamp
    stamp = (*times, path.suffix)  # which decides how it is read
    if os.environ.get(VERIFY):
        return read(path)
    if stamp not in _SEEN and (before := _base(how, os.getpid()).find(stamp)) is not None:
        _SEEN[stamp] = before
    if stamp in _SEEN:
        return _SEEN[stamp]
    found = read(path)
    if time.time_ns() - max(times[2], times[3]) > SETTLED:
        _SEEN[stamp] = found
        _base(how, os.getpid()).keep(stamp, found)
    return found


_SEEN: dict[Stamp, bytes] = {}


class _Base:
    """The data base; where there can be none, nothing is remembered.

    Args:
        name: Of its file; each way in which hashes are computed has its own.
    """

    def __init__(self, name: str) -> None:
        self._open: sqlite3.Connection | None = None
        with suppress(OSError, sqlite3.Error):
            file = own_folder(cache_folder("hashes")) / name
            self._open = sqlite3.connect(file, timeout=2, isolation_level=None, check_same_thread=False)
            self._open.execute("PRAGMA synchronous = OFF")  # hashes lost in a crash of the system are computed again
            self._open.execute("CREATE TABLE IF NOT EXISTS files (stamp TEXT PRIMARY KEY, hash BLOB, seal BLOB)")
            if self._open.execute("SELECT count(*) FROM files").fetchone()[0] > MOST:
                self._open.execute("DELETE FROM files")

    def __del__(self) -> None:
        if self._open is not None:  # Python 3.13 warns of one that is left open
            self._open.close()

    def find(self, stamp: Stamp) -> bytes | None:
        """The hash of a file with this stamp."""
        if self._open is None:
            return None
        with suppress(sqlite3.Error):  # busy, or damaged
            row = self._open.execute("SELECT hash, seal FROM files WHERE stamp = ?", (repr(stamp),)).fetchone()
            if row is not None and row[1] == _seal(stamp, row[0]):
                return bytes(row[0])
        return None

    def keep(self, stamp: Stamp, found: bytes) -> None:
        """Remember it."""
        if self._open is not None:
            with suppress(sqlite3.Error):
                row = (repr(stamp), found, _seal(stamp, found))
                self._open.execute("INSERT OR REPLACE INTO files VALUES (?, ?, ?)", row)


def _seal(stamp: Stamp, found: bytes) -> bytes:
    """Of a row: a data base that a crash has damaged may mix them."""
    return hashlib.blake2b(repr(stamp).encode() + found, digest_size=8).digest()


@cache
def _base(how: str, process: int) -> _Base:
    """One for each process: a connection does not survive a fork."""
    return _Base(f"{how}.db")
