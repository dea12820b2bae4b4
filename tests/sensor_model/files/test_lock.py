"""Claims about the lock on a folder: one at a time, whoever it is, and it ends with its holder."""

import errno
import fcntl
import os
import platform
import re
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from sensor_model.files.atomic import atomic
from sensor_model.files.door import given
from sensor_model.files.lock import NAME, dry, locked

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


@contextmanager
def another_process(body: Callable[[Callable[[], None]], None]) -> Iterator[int]:
    """A forked process that calls `body`, which calls its argument when the block may begin, and then waits there."""
    ready, go = os.pipe(), os.pipe()
    process = os.fork()
    if process == 0:
        try:
            os.close(go[1])

            def pause() -> None:
                os.write(ready[1], b"!")
                os.read(go[0], 1)  # until the other end is closed

            body(pause)
            os._exit(0)
        except BaseException:
            os._exit(1)
    os.read(ready[0], 1)
    try:
        yield process
    finally:
        for end in (*ready, *go):
            os.close(end)
        os.waitpid(process, 0)


def holding(folder: Path) -> Callable[[Callable[[], None]], None]:
    def body(pause: Callable[[], None]) -> None:
        with locked(folder):
            pause()

    return body


def test_a_folder_in_use_is_refused_and_its_holder_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    with another_process(holding(folder)) as process:
        with pytest.raises(BlockingIOError) as refused, locked(tmp_path / "." / "out"):
            pass
        assert re.fullmatch(
            rf"{folder} is in use by '.+' \(process {process} on {re.escape(platform.node())}, since \d{{4}}-\d\d-\d\d "
            r"\d\d:\d\d:\d\d [+-]\d{4}\): wait until it is done \(--wait does\), or choose another folder",
            str(refused.value),
        )
        assert (folder / NAME).exists()
    with locked(folder) as held:
        assert held


def test_a_killed_holder_holds_nothing(tmp_path: Path) -> None:
    with another_process(holding(tmp_path)) as process:
        os.kill(process, signal.SIGKILL)
        os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
        assert (tmp_path / NAME).exists()
        with locked(tmp_path) as held:
            assert held
    assert list(tmp_path.iterdir()) == []


def test_its_holder_may_take_it_again_another_thread_may_not(tmp_path: Path) -> None:
    refused = []

    def other() -> None:
        try:
            with locked(tmp_path):
                pass
        except BlockingIOError as error:
            refused.append(str(error))

    (tmp_path / "link").symlink_to(tmp_path)
    with locked(tmp_path):
        with locked(tmp_path / "link") as held:
            assert held
        assert (tmp_path / NAME).exists()  # the inner one ends before the outer one
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert f"process {os.getpid()}" in refused[0]


def test_a_forked_child_that_ends_releases_nothing_of_its_parent(tmp_path: Path) -> None:
    with locked(tmp_path):
        if (process := os.fork()) == 0:
            os._exit(_leaves_like_its_parent(tmp_path))
        assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0
        assert (tmp_path / NAME).exists()


def _leaves_like_its_parent(folder: Path) -> int:
    lock = locked(folder / "own")
    lock.__enter__()
    if (process := os.fork()) == 0:
        lock.__exit__(None, None, None)
        os._exit(0)
    os.waitpid(process, 0)
    return 0 if (folder / "own" / NAME).exists() else 1


def test_one_may_wait_and_is_told_for_whom(tmp_path: Path) -> None:
    told: list[str] = []

    def hold(pause: Callable[[], None]) -> None:
        with locked(tmp_path):
            pause()
            (tmp_path / "result").write_text("done")

    done = threading.Event()

    def wait() -> None:
        # The lock of a stage inside that of a command waits as the command does.
        with locked(tmp_path / "other", wait=told.append), locked(tmp_path):
            assert (tmp_path / "result").read_text() == "done"
            done.set()

    with another_process(hold):
        thread = threading.Thread(target=wait)
        thread.start()
        while not told and thread.is_alive():
            thread.join(0.01)
        assert not done.is_set()
    thread.join()
    assert done.is_set()
    assert len(told) == 1
    assert told[0].startswith(f"waiting for {tmp_path}, in use by '")


def test_no_two_of_many_are_ever_inside_at_once(tmp_path: Path) -> None:
    """Rationale: the lock file goes with its holder, so those who wait for it wait for a file that no longer exists."""
    rounds, processes = 40, []
    counter = tmp_path / "counter"
    counter.write_text("0")
    for _ in range(4):
        process = os.fork()
        if process == 0:
            try:
                for _ in range(rounds):
                    with locked(tmp_path / "out", wait=lambda _: None):
                        counter.write_text(str(int(counter.read_text()) + 1))
                os._exit(0)
            except BaseException:
                os._exit(1)
        processes.append(process)
    assert [os.waitpid(process, 0)[1] for process in processes] == [0] * 4
    assert counter.read_text() == str(4 * rounds)


def test_nothing_stays_of_a_lock_under_which_nothing_was_written(tmp_path: Path) -> None:
    with locked(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b" / NAME).exists()
    assert list(tmp_path.iterdir()) == []
    with locked(tmp_path / "a" / "b"):
        (tmp_path / "a" / "b" / "result").write_text("kept")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a", "b", "result"]
    with locked(tmp_path / "missing", make=False) as held:
        assert not held
        assert not (tmp_path / "missing").exists()


def test_a_folder_that_goes_while_it_is_made_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: `mkdir` finds the folder of another process, and when it looks whether that is one it is gone."""
    made, times = Path.mkdir, []

    def races(self: Path, *args: Any, **options: Any) -> None:
        times.append(self)
        if len(times) < 3:
            raise FileExistsError(errno.EEXIST, "File exists", str(self))
        made(self, *args, **options)

    monkeypatch.setattr(Path, "mkdir", races)
    with locked(tmp_path / "out") as held:
        assert held
    assert len(times) == 3


def test_where_no_folder_can_be_made_nobody_waits_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path, *_: Any, **__: Any) -> None:
        raise FileNotFoundError(errno.ENOENT, "No such file or directory", str(self))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(FileNotFoundError, match="out"), locked(tmp_path / "out"):
        pass


def test_a_file_is_no_folder_to_write_to(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("precious")
    with pytest.raises(NotADirectoryError, match=r"a is a file, not a folder"), locked(tmp_path / "a"):
        pass


@pytest.mark.parametrize("code", [errno.EROFS, errno.EACCES])
def test_where_nobody_can_write_nothing_needs_a_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", refuse)
        with locked(tmp_path) as held:
            assert not held


def test_a_lock_file_of_another_user_is_locked_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = os.open

    def readable(path: Path, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_RDWR:
            raise PermissionError(errno.EACCES, "not yours")
        return opened(path, flags, mode)

    with another_process(holding(tmp_path)), monkeypatch.context() as patch:
        patch.setattr(os, "open", readable)
        with pytest.raises(BlockingIOError, match="in use by"), locked(tmp_path):
            pass


def test_a_file_system_without_locks_is_said_once_and_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(fcntl, "flock", fails)
    with pytest.warns(UserWarning, match="lies on a file system without locks"), locked(tmp_path) as held:
        assert not held
    with locked(tmp_path):  # a second warning would be an error here
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_killed_processes_left_half_written_is_swept_and_nothing_else(tmp_path: Path) -> None:
    dead = os.fork()
    if dead == 0:
        os._exit(0)
    os.waitpid(dead, 0)
    (tmp_path / "parts" / "deep").mkdir(parents=True)
    (tmp_path / "not ours").mkdir()
    gone = [f".a.b.{dead}.partial.png", f"parts/deep/.0.{dead}.partial", f".mine.{os.getpid()}.partial.json"]
    kept = [
        ".hidden",
        ".a.partial.png",
        f"a.{dead}.partial",
        f"not ours/.a.{dead}.partial",
        f".b.{os.getppid()}.partial",
    ]
    for name in (*gone, *kept):
        (tmp_path / name).write_text("half")
    with locked(tmp_path, ("parts",)):
        assert [name for name in (*gone, *kept) if (tmp_path / name).exists()] == kept
        with atomic(tmp_path / "now.txt") as temporary:
            temporary.write_text("being written")
            with locked(tmp_path):
                assert temporary.exists()
    assert (tmp_path / "now.txt").exists()


@pytest.mark.parametrize("way", [os.symlink, os.link], ids=["link", "second name"])
def test_the_lock_file_is_no_way_to_write_over_another_file(tmp_path: Path, way: Callable[[Path, Path], None]) -> None:
    victim, folder = tmp_path / "victim", tmp_path / "out"
    victim.write_text("precious")
    folder.mkdir()
    way(victim, folder / NAME)
    with pytest.raises(ValueError, match="is not a file that novags made: remove it"), locked(folder):
        pass
    assert victim.read_text() == "precious"
    assert (folder / NAME).exists()


def test_a_fifo_under_the_name_of_the_lock_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / NAME)
    with pytest.raises(ValueError, match="is not a file that novags made"), locked(tmp_path):
        pass


def test_a_file_of_somebody_else_under_the_name_of_the_lock_is_kept(tmp_path: Path) -> None:
    (tmp_path / NAME).write_text("notes of mine")
    with pytest.raises(ValueError, match="it is not a lock file"), locked(tmp_path):
        pass
    assert (tmp_path / NAME).read_text() == "notes of mine"


def test_the_name_of_a_killed_holder_is_written_over(tmp_path: Path) -> None:
    (tmp_path / NAME).write_text("'novags report x' (process 12 on host, since 2026-01-01 00:00:00 +0000)")
    with locked(tmp_path) as held:
        assert held
        assert f"process {os.getpid()} " in (tmp_path / NAME).read_text()


def test_a_lock_behind_a_link_out_of_a_given_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "given").mkdir()
    (tmp_path / "outside").mkdir()
    (tmp_path / "given" / "run").symlink_to(tmp_path / "outside")
    with given([str(tmp_path / "given")]):
        with pytest.raises(ValueError, match="--allow-links"), locked(tmp_path / "given" / "run"):
            pass
    assert list((tmp_path / "outside").iterdir()) == []


@pytest.fixture
def looking() -> Iterator[None]:
    token = dry.set(True)
    yield
    dry.reset(token)


@pytest.mark.usefixtures("looking")
def test_in_a_dry_run_nothing_is_held_made_or_swept(tmp_path: Path) -> None:
    (tmp_path / f".a.{2**30}.partial").touch()
    (tmp_path / NAME).write_text(f"'novags' (process {2**30} on here, since yesterday)")  # of one that was killed
    for folder in (tmp_path, tmp_path / "a" / "b"):
        before = [(path.name, path.stat().st_mtime_ns) for path in (tmp_path, *sorted(tmp_path.iterdir()))]
        with locked(folder) as held:
            assert not held
            assert [(path.name, path.stat().st_mtime_ns) for path in (tmp_path, *sorted(tmp_path.iterdir()))] == before


@pytest.mark.usefixtures("looking")
def test_a_dry_run_is_refused_where_the_folder_is_in_use_or_cannot_be_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def holds(pause: Callable[[], None]) -> None:
        dry.set(False)
        holding(tmp_path / "out")(pause)

    with another_process(holds), pytest.raises(BlockingIOError, match="in use by"), locked(tmp_path / "out"):
        pass
    (tmp_path / "file").touch()
    for wrong in (tmp_path / "file", tmp_path / "file" / "deeper" / "still"):
        with pytest.raises(NotADirectoryError, match="file"), locked(wrong):
            pass
    (tmp_path / NAME).write_text("my notes")
    with pytest.raises(ValueError, match="it is not a lock file"), locked(tmp_path):
        pass
    monkeypatch.setattr(os, "access", lambda place, _: Path(place) != tmp_path)
    with pytest.raises(PermissionError, match=f"{tmp_path}/a'"), locked(tmp_path / "a" / "b"):
        pass
