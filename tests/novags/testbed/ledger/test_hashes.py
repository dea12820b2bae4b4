"""Claims about hashes that are remembered from one process to the next."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from novags.testbed.ledger import hashes
from novags.testbed.ledger.hashes import VERIFY, remembered


class Reader:
    """Reads files, and counts how often."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self, path: Path) -> bytes:
        self.count += 1
        return path.read_bytes()[::-1]


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Reader:
    """With a data base of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(VERIFY, raising=False)
    forget()
    return Reader()


def forget() -> None:
    """As another process begins."""
    hashes._SEEN.clear()
    hashes._base.cache_clear()


def test_the_data_base_is_closed_with_the_last_who_asks(reader: Reader) -> None:
    connection = hashes._base("x", os.getpid())._open
    assert connection is not None
    assert connection.execute("SELECT 1").fetchone() == (1,)
    forget()
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        connection.execute("SELECT 1")


def settled(path: Path, content: bytes, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file that was written some time ago."""
    path.write_bytes(content)
    later = os.stat(path).st_ctime_ns + 3_000_000_000
    monkeypatch.setattr("novags.testbed.ledger.hashes.time.time_ns", lambda: later)
    return path


def test_a_file_is_read_once_by_all_processes_until_it_changes(
    tmp_path: Path, reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = settled(tmp_path / "a.png", b"12", monkeypatch)
    for _ in range(3):
        assert remembered(file, reader, "x") == b"21"
        forget()
    assert reader.count == 1
    times = os.stat(file)
    file.write_bytes(b"34")
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))  # of the same size and time of modification
    assert remembered(file, reader, "x") == b"43"
    other = tmp_path / "b.png"
    other.write_bytes(b"56")
    os.utime(other, ns=(times.st_atime_ns, times.st_mtime_ns))
    other.replace(file)
    assert remembered(file, reader, "x") == b"65"


def test_a_file_that_was_just_written_is_read_again(tmp_path: Path, reader: Reader) -> None:
    file = tmp_path / "a.png"
    file.write_bytes(b"12")
    for _ in range(2):
        remembered(file, reader, "x")
    assert reader.count == 2


def test_verify_reads_every_file(tmp_path: Path, reader: Reader, monkeypatch: pytest.MonkeyPatch) -> None:
    file = settled(tmp_path / "a.png", b"12", monkeypatch)
    remembered(file, reader, "x")
    monkeypatch.setenv(VERIFY, "1")
    for _ in range(2):
        assert remembered(file, reader, "x") == b"21"
    assert reader.count == 3


def test_hashes_of_another_kind_or_suffix_are_others(
    tmp_path: Path, reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = settled(tmp_path / "a.png", b"12", monkeypatch)
    remembered(file, reader, "x")
    forget()
    remembered(file, reader, "y")
    linked = tmp_path / "a.json"
    linked.hardlink_to(file)
    monkeypatch.setattr("novags.testbed.ledger.hashes.time.time_ns", lambda: os.stat(file).st_ctime_ns + 3 * 10**9)
    remembered(linked, reader, "y")
    assert reader.count == 3


@pytest.mark.parametrize("harm", ["garbage", "mixed rows", "a folder", "no folder"])
def test_a_damaged_memory_costs_nothing_but_time(
    tmp_path: Path, reader: Reader, harm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = settled(tmp_path / "a.png", b"12", monkeypatch)
    remembered(file, reader, "x")
    forget()
    base = tmp_path / "cache" / "novags" / "hashes" / "x.db"
    if harm == "mixed rows":
        with closing(sqlite3.connect(base)) as found, found:
            found.execute("UPDATE files SET hash = ?", (b"of another file",))
    else:
        base.unlink()
        if harm == "garbage":
            base.write_bytes(os.urandom(5000))
        elif harm == "a folder":
            base.mkdir()
        else:
            base.parent.rmdir()
            base.parent.write_bytes(b"")
    assert remembered(file, reader, "x") == b"21"
    assert reader.count == 2


def test_a_missing_file_is_not_remembered(tmp_path: Path, reader: Reader, monkeypatch: pytest.MonkeyPatch) -> None:
    file = settled(tmp_path / "a.png", b"12", monkeypatch)
    remembered(file, reader, "x")
    file.unlink()
    with pytest.raises(FileNotFoundError):
        remembered(file, reader, "x")


def test_a_hash_under_the_stamp_of_another_file_is_not_believed(reader: Reader) -> None:
    """As a data base that a crash has damaged may have it: the seal of a row is of its stamp, too."""
    base = hashes._base("x", 0)
    first, second = (1, 2, 3, ".png"), (1, 2, 4, ".png")
    base.keep(first, b"one")
    base.keep(second, b"two")
    assert (base.find(first), base.find(second)) == (b"one", b"two")
    assert base._open is not None
    row = base._open.execute("SELECT hash, seal FROM files WHERE stamp = ?", (repr(first),)).fetchone()
    base._open.execute("UPDATE files SET hash = ?, seal = ? WHERE stamp = ?", (*row, repr(second)))
    assert base.find(first) == b"one"
    assert base.find(second) is None
