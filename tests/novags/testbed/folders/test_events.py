"""Claims about events.jsonl: on disk at once, and in the end that of a run that was never stopped."""

import json
import os
import signal
from pathlib import Path

import pytest

from novags.testbed.folders.events import EventLog
from novags.testbed.folders.run import Run

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


def lines(*steps: int) -> str:
    return "".join(f'{{"step": {step}, "loss": {1 / step}}}\n' for step in steps)


def add(log: EventLog, *steps: int) -> None:
    for step in steps:
        log.add({"step": step, "loss": 1 / step})


def test_a_killed_process_has_lost_none_of_its_events(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    if (process := os.fork()) == 0:
        with EventLog(path) as log:
            add(log, 10, 20)
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(process, 0)
    assert path.read_text() == lines(10, 20)


@pytest.mark.parametrize(
    ("there", "goes_on"),
    [
        (lines(10, 20, 30, 40), (30, 40, 50)),  # killed after the checkpoint of step 20
        (lines(10, 20, 30) + '{"step": 40, "lo', (30, 40, 50)),
        (lines(10, 20, 30) + '{"step": 40, "lo', (10, 20, 30, 40, 50)),  # before the first checkpoint
        (lines(10, 20, 30, 40, 50), ()),  # after the last one
        (lines(10, 20, 30, 40, 50) + "{}\n[1]\nnull\n\xff", ()),
        (lines(10, 20, 30, 40, 50) + '{"step": 1e400}\n{"step": ' + "[" * 10**5, ()),
        ("", (10, 20, 30, 40, 50)),
    ],
)
def test_a_run_that_goes_on_ends_with_the_log_of_one_that_never_stopped(
    there: str, goes_on: tuple[int, ...], tmp_path: Path
) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text(there, encoding="latin-1")
    with EventLog(path) as log:
        add(log, *goes_on)
    assert path.read_text() == lines(10, 20, 30, 40, 50)


def test_a_run_that_fails_before_its_first_step_keeps_what_was_logged(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text(lines(10, 20))
    with pytest.raises(KeyboardInterrupt), EventLog(path):
        raise KeyboardInterrupt
    assert path.read_text() == lines(10, 20)


def test_values_without_a_json_form_of_their_own_are_spelled_out(tmp_path: Path) -> None:
    with EventLog(tmp_path / "events.jsonl") as log:
        log.add({"step": 1, "loss": float("inf")})
    assert json.loads((tmp_path / "events.jsonl").read_text()) == {"step": 1, "loss": "inf"}


def test_a_run_without_steps_has_an_empty_log(tmp_path: Path) -> None:
    with EventLog(tmp_path / "events.jsonl"):
        pass
    assert (tmp_path / "events.jsonl").read_text() == ""


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('{"step": 2, "photometric": 0.5}', "iteration must be there"),
        ('{"iteration": -1, "photometric": 0.5}', "iteration must be >= 0, got -1"),
        ('{"iteration": 1, "photometric": 1e308}', r"photometric must be <= 3.4e\+38, got 1e\+308"),
        ('{"iteration": 1, "photometric": [0.5]}', "photometric must be"),
        ('{"iteration": 1, "photometric": NaN}', "NaN"),
        ('{"iteration": 1' + "0" * 400 + ', "photometric": 1}', "400|401"),
        ("[" * 100_000, "nested"),
        ("[]", "must be an object"),
        ("{", "not valid JSON"),
    ],
)
def test_a_damaged_line_is_named_with_what_is_wrong_in_it(tmp_path: Path, line: str, said: str) -> None:
    good = '{"iteration": 1, "photometric": "inf"}'
    (tmp_path / "events.jsonl").write_text(f"{good}\n{line}\n")
    with pytest.raises(ValueError, match=said) as error:
        Run(tmp_path, {}).events()
    assert str(error.value).startswith(f"{tmp_path}/events.jsonl, line 2")
    assert len(str(error.value)) < 400 + len(str(tmp_path))


def test_a_log_that_is_a_link_or_not_utf8_is_refused_by_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "victim").write_text(lines(1))
    (tmp_path / "events.jsonl").symlink_to(tmp_path / "victim")
    log = EventLog(tmp_path / "events.jsonl")
    monkeypatch.setattr(log, "_keep", lambda before: None)  # which puts a file in the place of the link
    with pytest.raises(ValueError, match=r"events\.jsonl is not a file that novags made"):
        add(log, 2)
    assert (tmp_path / "victim").read_text() == lines(1)
    (tmp_path / "events.jsonl").unlink()
    (tmp_path / "events.jsonl").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"events\.jsonl is missing or damaged .*UTF-8"):
        Run(tmp_path, {}).events()
