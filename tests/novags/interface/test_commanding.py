"""Claims about a command in the background: what it says is kept whole and in order, and shown where that is asked."""

import sys
import time
from pathlib import Path
from typing import Any

import pytest

from novags.interface import commanding
from novags.interface.commanding import BackgroundCommand, CommandError

TALK = "import sys; print('first'); print('second', file=sys.stderr, flush=True); print('third'); sys.exit({})"
WAIT = """
import os, time
while not os.path.exists({!r}):
    time.sleep(0.01)
print("begun")
time.sleep(60)
"""
LINES = ["first", "second", "third"]


def talking(monkeypatch: pytest.MonkeyPatch, program: str = TALK.format(0)) -> list[tuple[str, ...]]:
    """Put a process that says three lines, or another, in the place of every command; the commands that are asked for.

    The results of a command are the name of its folder.
    """
    asked: list[tuple[str, ...]] = []

    def python(_: str, *words: str) -> list[str]:
        asked.append(words)
        return [sys.executable, "-I", "-u", "-c", program]

    monkeypatch.setattr(commanding, "python", python)
    monkeypatch.setattr(commanding, "results_of", lambda out: out.name)
    return asked


@pytest.mark.parametrize("show", [True, False])
def test_every_line_of_a_command_is_kept_and_shown_where_that_is_asked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, show: bool
) -> None:
    asked = talking(monkeypatch)
    job = BackgroundCommand(["run", "--quiet"], tmp_path / "made", show)
    assert job.wait() == "made"
    assert asked == [("run", "--quiet")]
    assert [*job.said] == LINES
    assert (job.progress, job.running) == ("third", False)
    assert capsys.readouterr().err.splitlines() == (LINES if show else [])


def test_what_a_command_said_last_is_known_when_it_has_ended_however_slowly_it_is_shown(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys.stderr, "write", lambda _: time.sleep(0.05))
    talking(monkeypatch)
    job = BackgroundCommand(["run"], tmp_path, show=True)
    job.wait()
    assert [*job.said] == LINES
    talking(monkeypatch, WAIT.format(str(tmp_path)))
    job = BackgroundCommand(["run"], tmp_path, show=True)
    while not job.said:
        time.sleep(0.01)
    job.stop()
    assert job.progress == "KeyboardInterrupt"


def test_a_command_that_fails_says_why_in_its_last_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    talking(monkeypatch, TALK.format(2))
    with pytest.raises(CommandError, match="novags study ended with 2: third$"):
        commanding.study("x.toml", out=tmp_path, show=False)


def test_of_a_long_talk_the_last_lines_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    talking(monkeypatch, "print(*range(1000), sep='\\n')")
    job = BackgroundCommand(["run"], tmp_path, show=False)
    job.wait()
    assert [*job.said] == [str(k) for k in range(800, 1000)]


def test_progress_is_shown_unless_it_is_not_wanted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    talking(monkeypatch)
    commanding.run(out=tmp_path)
    commanding.study("x.toml", out=tmp_path)
    assert capsys.readouterr().err.splitlines() == [*LINES, *LINES]


def test_a_command_that_is_stopped_has_ended_and_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    talking(monkeypatch, WAIT.format(str(tmp_path / "go")))
    job = BackgroundCommand(["run"], tmp_path, show=False)
    assert (job.progress, job.running) == ("", True)
    assert job._reader.daemon  # else a program that does not wait for it would not end
    (tmp_path / "go").touch()
    while not job.said:
        time.sleep(0.01)
    with pytest.raises(TimeoutError, match=r"novags run is not done after 0\.01 s: begun"):
        job.wait(0.01)
    job.stop()
    assert not job.running
    assert job.progress == "KeyboardInterrupt"
    with pytest.raises(CommandError, match="novags run ended with -2: KeyboardInterrupt"):
        job.wait()


def test_ctrl_c_while_a_command_is_waited_for_stops_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    talking(monkeypatch, WAIT.format(str(tmp_path)))
    job = BackgroundCommand(["run"], tmp_path, show=False)
    while not job.said:
        time.sleep(0.01)
    wait = job._process.wait

    def interrupted(timeout: float | None = None) -> int:
        monkeypatch.setattr(job._process, "wait", wait)
        raise KeyboardInterrupt

    monkeypatch.setattr(job._process, "wait", interrupted)
    try:
        with pytest.raises(KeyboardInterrupt):
            job.wait()
        assert not job.running
    finally:
        job._process.kill()


def test_options_are_typed_as_a_shell_would_type_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = talking(monkeypatch)
    settings: dict[str, Any] = {
        "methods": ["naive", "nova"],
        "variant": ("a=naive:init_scale=2", "b=naive:init_scale=3"),
        "views": 9,
    }
    found = commanding.run(out=tmp_path / "made", overwrite=True, wait=False, spp=None, show=False, **settings)
    assert found == "made"
    job = commanding.run(out=tmp_path / "made", background=True, show=False)
    assert isinstance(job, BackgroundCommand)
    job.wait()
    out = ("run", "--out", str(tmp_path / "made"))
    variants = ("--variant", "a=naive:init_scale=2", "--variant", "b=naive:init_scale=3")
    assert asked == [(*out, "--overwrite", "--methods", "naive", "nova", *variants, "--views", "9"), out]
