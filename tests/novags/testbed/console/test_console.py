"""Claims about what is printed: names from outside cannot steer the terminal."""

import io
import sys

import pytest

from novags.commands.shared import next_, say
from novags.failure import errors_in_one_line
from novags.testbed.console.terminal import Console, losses_text
from novags.testbed.study.engines.progress import StudyProgress

NAME = "a\x1b]0;title\x07\x1b[2J\u202eb\x9b1m\rc[red]"
SHOWN = r"a\x1b]0;title\x07\x1b[2J\u202eb\x9b1m\rc[red]"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_notes_and_progress_show_control_characters_escaped() -> None:
    stream = io.StringIO()
    console = Console(stream=stream)
    console.note(f"two lines\nof {NAME}")
    console.warn(NAME)
    with console.progress(NAME) as update:
        update(1, 1, NAME)
    assert stream.getvalue().count(SHOWN) == 4
    assert stream.getvalue().startswith("two lines\nof a")
    assert not {"\x1b", "\x07", "\x9b", "\r", "\u202e"} & set(stream.getvalue())


def test_bars_show_control_characters_escaped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "400")
    stream = Terminal()
    console = Console(stream=stream)
    assert console.live
    with console.progress(NAME) as update:
        update(1, 2, NAME)
    progress = StudyProgress(console, 1)
    progress.note(NAME)
    progress.show(0, 0, {"key": (NAME, ("stage", 1, 2, NAME))}, 1.0)
    progress.close()
    assert stream.getvalue().count(SHOWN[:30]) >= 4
    assert not {"\x07", "\x9b", "\u202e"} & set(stream.getvalue())
    assert "\x1b]0;title" not in stream.getvalue()
    assert "[red]" in stream.getvalue()


def test_what_is_said_during_a_study_leaves_its_bars_whole_and_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: bars had a terminal of their own, and a note to the other one was printed into them."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "200")
    stream = Terminal()
    console = Console(stream=stream)
    progress = StudyProgress(console, 5)
    progress.show(1, 0, {"key": ("one place", ("fit", 3, 10, "l1 0.25"))}, 100.0)
    console.warn("careful")
    after = stream.getvalue().partition("note: careful")[2]
    progress.close()
    assert "runs" in after
    assert "one place" in after


def test_commands_show_control_characters_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    say(f"{NAME}\n{NAME}")
    next_(NAME)
    assert capsys.readouterr() == (f"{SHOWN}\n{SHOWN}\n", f"next: {SHOWN}\n")


@pytest.mark.parametrize("error", [ValueError(NAME), OSError(NAME), RuntimeError(NAME)])
def test_errors_show_control_characters_escaped(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["novags"])
    monkeypatch.delenv("NOVAGS_TRACEBACK", raising=False)
    with pytest.raises(SystemExit), errors_in_one_line():
        raise error
    said = capsys.readouterr().err
    assert not {"\x1b", "\x07", "\x9b", "\r", "\u202e"} & set(said)
    assert r"\x1b]0;title\x07" in said


def test_all_losses_of_a_step_are_told_but_for_counters_and_norms() -> None:
    losses = {"iteration": 3, "l1": 0.5, "norm_means": 1.0, "dssim": 0.25, "n_gaussians": 9, "depth": 2.0}
    assert losses_text(losses) == "l1 0.5000  dssim 0.2500  depth 2.0000"
    assert losses_text({"l1": 0.5, "dssim": 0.25}) == "l1 0.5000  dssim 0.2500"
