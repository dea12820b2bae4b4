"""Claims about temporary folders."""

import os
import signal
import tempfile
from pathlib import Path

import pytest

from sensor_model.files.scratch import scratch

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


def test_what_a_killed_process_left_is_removed_and_what_is_in_use_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ready, go = os.pipe(), os.pipe()
    processes = []
    for killed in (True, False):
        if (process := os.fork()) == 0:
            with scratch("test") as folder:
                (folder / "file").write_text("killed" if killed else "in use")
                os.write(ready[1], b"!")
                if killed:
                    os.kill(os.getpid(), signal.SIGKILL)
                os.read(go[0], 1)
            os._exit(0)
        os.read(ready[0], 1)
        processes.append(process)
    os.waitpid(processes[0], 0)
    (tmp_path / "novags-test-new").mkdir()  # by a process that has not locked it yet
    for folder in tmp_path.glob("novags-test-?*"):
        if folder.name != "novags-test-new":
            os.utime(folder, (1e9, 1e9))
    with scratch("test") as mine:
        left = [file.read_text() for file in tmp_path.glob("*/file")]
        assert left == ["in use"]
        assert mine.is_dir()
        assert (tmp_path / "novags-test-new").is_dir()
    os.write(go[1], b"!")
    os.waitpid(processes[1], 0)
    assert [path.name for path in tmp_path.iterdir()] == ["novags-test-new"]
    for end in (*ready, *go):
        os.close(end)


def test_links_and_pipes_that_are_called_as_a_folder_left_behind_are_let_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: to open a pipe waits for ever for somebody who writes to it."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").touch()
    (tmp_path / "novags-test-link").symlink_to(tmp_path / "mine")
    os.mkfifo(tmp_path / "novags-test-pipe")
    for path in tmp_path.iterdir():
        os.utime(path, (1e9, 1e9), follow_symlinks=False)
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it waits"))
    signal.alarm(20)
    try:
        with scratch("test"):
            pass
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
    assert (tmp_path / "mine" / "file").exists()
    assert (tmp_path / "novags-test-pipe").exists()
