"""Measuring: nothing twice, nothing lost, nothing mixed."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.console.terminal import Console, Update
from novags.testbed.ledger.dry import dry_run
from novags.testbed.pareto import samples as samples_module
from novags.testbed.pareto.curve import curves
from novags.testbed.pareto.measure import measure, time_left
from novags.testbed.pareto.samples import Samples, work_folder

QUIET = Console(quiet=True)


class Telling(Console):
    """Keeps what progress was told."""

    def __init__(self) -> None:
        super().__init__(quiet=True)
        self.told: list[tuple[int, int, str]] = []

    @contextmanager
    def progress(self, stage: str, parts: Any = None) -> Iterator[Update]:
        yield lambda done, total, what: self.told.append((done, total, f"{stage}: {what}"))


def test_every_setting_is_measured_once_a_seed_and_shared_defaults_once(made: Any, tmp_path: Path) -> None:
    measure(made.subject, tmp_path, 2, QUIET)
    first = [("steps", 1, 0), ("steps", 10, 0), ("steps", 100, 0), ("way", "bb", 0), ("way", None, 0),
             ("lone", 1.5, 0), ("lone", 22.75, 0)]  # fmt: skip
    assert made.asked == first + [(name, setting, 1) for name, setting, _ in first]


def test_an_interruption_keeps_what_is_measured_and_the_rest_follows(made: Any, tmp_path: Path) -> None:
    whole = measure(made.subject, tmp_path / "whole", 2, QUIET)
    asked, made.asked = made.asked, []
    for stop in (0, 5, 9):
        made.stop_at = stop
        with pytest.raises(KeyboardInterrupt):
            measure(made.subject, tmp_path / "parts", 2, QUIET)
    made.stop_at = None
    again = measure(made.subject, tmp_path / "parts", 2, QUIET)
    assert made.asked == asked  # none twice
    assert curves(made.subject, again) == curves(made.subject, whole)


def test_each_measurement_is_on_disk_before_the_next_one_begins(made: Any, tmp_path: Path) -> None:
    file = tmp_path / "made.samples.json"

    def look() -> None:
        kept = json.loads(file.read_text())["samples"] if file.exists() else []
        assert len(kept) == len(made.asked)

    made.before = look
    measure(made.subject, tmp_path, 1, QUIET)
    assert len(made.asked) == 7


def test_more_repetitions_add_to_those_that_are_there(made: Any, tmp_path: Path) -> None:
    measure(made.subject, tmp_path, 1, QUIET)
    made.asked = []
    measure(made.subject, tmp_path, 3, QUIET)
    assert {seed for *_, seed in made.asked} == {1, 2}


def test_a_dry_run_counts_what_is_missing_and_kept_and_measures_nothing(
    made: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measure(made.subject, tmp_path, 1, QUIET, only=["steps"])
    made.asked, before = [], (tmp_path / "made.samples.json").read_bytes()
    with dry_run():
        measure(made.subject, tmp_path, 2, Console())
    assert (made.asked, (tmp_path / "made.samples.json").read_bytes()) == ([], before)
    said = capsys.readouterr().err
    for line in ("steps: 3 measurements to be made, 3 kept", "way: 4 measurements to be made, 0 kept", "lone: 4 meas"):
        assert f"pareto made: {line}" in said
    made.workload = {"scene": "a wall", "size": 9}
    with dry_run():
        measure(made.subject, tmp_path, 2, Console(), overwrite=True)
    said = capsys.readouterr().err
    assert "pareto made: measured again in" in said
    assert "holds measurements of another workload" in said
    assert "steps: 6 measurements to be made, 0 kept" in said
    assert (tmp_path / "made.samples.json").read_bytes() == before


@pytest.mark.parametrize("what", ["workload", "hardware", "package", "code"])
def test_measurements_of_other_work_another_machine_or_other_software_are_never_mixed(
    what: str, made: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure(made.subject, tmp_path, 1, QUIET)
    before = (tmp_path / "made.samples.json").read_text()
    if what == "workload":
        made.workload = {"scene": "a wall", "size": 9}
    elif what == "code":
        monkeypatch.setattr(samples_module, "version", lambda: "another")
    else:
        here = samples_module.environment()
        other = {"hardware": {"processor": "abacus"}, "package": {**here["versions"], "numba": "0.1"}}[what]
        place = {"hardware": "hardware", "package": "versions"}[what]
        monkeypatch.setattr(samples_module, "environment", lambda: {**here, place: other})
    said = {"package": r"version of the software \(numba [^;]*\)", "code": r"version of the software \(code "}
    with pytest.raises(ValueError, match=rf"another {said.get(what, what)}.*choose another --out, or add --overwrite"):
        measure(made.subject, tmp_path, 1, QUIET)
    assert (tmp_path / "made.samples.json").read_text() == before
    made.asked = []
    measure(made.subject, tmp_path, 1, QUIET, overwrite=True)
    assert len(made.asked) == 7


def test_sets_and_truths_of_other_software_are_never_measured_against(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: --overwrite drops measurements, and what they were compared with must go with them."""
    before = work_folder(tmp_path)
    assert work_folder(tmp_path) == before
    monkeypatch.setattr(samples_module, "version", lambda: "another")
    assert work_folder(tmp_path) != before


def test_a_damaged_file_of_measurements_is_refused_by_name(made: Any, tmp_path: Path) -> None:
    measure(made.subject, tmp_path, 1, QUIET)
    file = tmp_path / "made.samples.json"
    file.write_text(file.read_text().replace('"seed": 0', '"seed": "zero"', 1))
    with pytest.raises(ValueError, match=r"made\.samples\.json: samples\[0\]\.seed must be a whole number"):
        measure(made.subject, tmp_path, 1, QUIET)


def test_progress_names_the_subject_the_point_and_the_time_left(made: Any, tmp_path: Path) -> None:
    console = Telling()
    measure(made.subject, tmp_path, 1, console)
    assert [(done, total) for done, total, _ in console.told] == [(k, 7) for k in range(8)]
    assert console.told[0][2] == "pareto made: steps = 1, seed 0"  # nothing is known yet
    assert console.told[3][2].startswith("pareto made: way = bb, seed 0, about 0 s left")


def test_the_time_left_is_foretold_by_the_same_setting_then_the_same_knob_then_all(made: Any, tmp_path: Path) -> None:
    subject = made.subject
    steps, way, lone = subject.knobs
    samples = Samples(tmp_path / "s.json", subject)
    for knob, setting, spent in ((steps, 1, 10.0), (steps, 100, 30.0), (way, "bb", 4.0)):
        samples.add(knob, setting, 0, knob.measure(setting, 0), spent)
    assert time_left(samples, [(steps, 100, 1)]) == "about 30 s left"
    assert time_left(samples, [(way, None, 1)]) == "about 4 s left"
    assert time_left(samples, [(lone, 1.5, 0)]) == "about 10 s left"  # the median of all
    assert time_left(samples, [(steps, 1, 1), (steps, 100, 1), (way, "bb", 2)]) == "about 44 s left"


def test_no_repetition_is_no_measurement(made: Any, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="repeats must be >= 1, got 0"):
        measure(made.subject, tmp_path, 0, QUIET)
