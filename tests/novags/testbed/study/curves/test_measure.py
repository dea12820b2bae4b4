"""Measuring: nothing twice, nothing lost, nothing mixed."""

import json
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.folders.runs import TABLE
from novags.testbed.study.costs import Costs
from novags.testbed.study.curves.curve import curves
from novags.testbed.study.curves.measuring import read_any
from novags.testbed.study.curves.study import told
from novags.testbed.study.engines.choice import OneMachine
from novags.testbed.study.knobs import measurement
from novags.testbed.study.knobs.subjects import sizes_of
from novags.testbed.study.results import CSV
from novags.testbed.study.session import again, refuse_other

QUIET = Console(quiet=True)
FIRST = [("steps", 1, 0), ("steps", 10, 0), ("steps", 100, 0), ("way", "bb", 0), ("way", None, 0), ("lone", 1.5, 0),
         ("lone", 22.75, 0)]  # fmt: skip


def test_every_setting_is_measured_once_a_seed_and_shared_defaults_once(made: Any) -> None:
    """Seeds come last: what else loads the machine meets all settings alike."""
    rows = made.measure(repeats=2)
    assert made.asked == FIRST + [(name, setting, 1) for name, setting, _ in FIRST]
    assert [(row["knob"], row["setting"], row["seed"]) for row in rows if row["setting"] in (10, "a")] == [
        ("steps", 10, 0), ("way", "a", 0), ("steps", 10, 1), ("way", "a", 1),
    ]  # fmt: skip
    assert {row["state"] for row in rows} == {"done"}


def test_an_interruption_keeps_what_is_measured_and_the_rest_follows(made: Any, tmp_path: Path) -> None:
    whole = made.measure(repeats=2)
    asked, made.asked, made.folder = made.asked, [], tmp_path / "parts"
    for stop in (0, 5, 9):
        made.stop_at = stop
        with pytest.raises(KeyboardInterrupt):
            made.measure(repeats=2)
    made.stop_at = None
    parts = made.measure(repeats=2)
    assert made.asked == asked  # none twice
    subject = made.subject(8)
    assert curves(subject, parts) == curves(subject, whole)


def test_each_measurement_is_in_the_store_before_the_next_one_begins(made: Any) -> None:
    made.before = lambda: kept.append(len(list(made.store.glob("measurement/*/.sealed.json"))))
    kept: list[int] = []
    made.measure()
    assert kept == list(range(7))


def test_more_repetitions_add_to_those_that_are_there_and_stay_when_fewer_are_asked_for(made: Any) -> None:
    made.measure()
    made.asked = []
    made.measure(repeats=3)
    assert {seed for *_, seed in made.asked} == {1, 2}
    assert {point["repeats"] for point in curves(made.subject(8), made.measure(repeats=1))} == {3}
    assert len(made.asked) == 14


def test_knobs_that_are_named_are_measured_alone_and_what_the_store_has_stays(made: Any) -> None:
    made.measure(knobs=("steps",))
    assert [name for name, *_ in made.asked] == ["steps"] * 3
    rows = made.measure(knobs=("lone",))
    assert [name for name, *_ in made.asked[3:]] == ["lone"] * 2
    assert {point["knob"] for point in curves(made.subject(8), rows)} == {"made.steps", "made.lone"}
    with pytest.raises(ValueError, match="made has no knob 'step'; its knobs: steps, way, lone"):
        made.plan(knobs=("step",))


def test_a_dry_run_counts_what_is_missing_and_kept(made: Any) -> None:
    made.measure(knobs=("steps",))
    said = list(told(made.plan(repeats=2), made.store))
    for line, found in zip(
        ("steps: 3 measurements to be made, 3 kept", "way: 5 meas", "lone: 4 meas"), said, strict=True
    ):
        assert found.startswith(f"pareto made: {line}")
    assert (
        list(told(made.plan(knobs=("steps",)), made.store))[0] == "pareto made: steps: unchanged, kept 3 measurements"
    )


@pytest.mark.parametrize("what", ["workload", "hardware", "package", "code"])
def test_measurements_of_other_work_another_machine_or_other_software_are_never_mixed(
    what: str, made: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    made.measure()
    before = made.plan()
    assert again(before, made.folder / "made", made.store) == ""
    if what == "code":
        made.modules = (*made.modules, "novags.numbers")
    elif what != "workload":
        here = measurement.environment()
        other = {"hardware": {"processor": "abacus"}, "package": {**here["versions"], "numba": "0.1"}}[what]
        place = {"hardware": "hardware", "package": "versions"}[what]
        monkeypatch.setattr(measurement, "environment", lambda: {**here, place: other})
    plan = made.plan(quick=what == "workload")
    assert not plan.ends & before.ends
    said = {
        "hardware": "abacus",
        "package": "0.1",
        "workload": "workload.size",
        "code": "novags/numbers.py",
    }
    assert said[what] in again(plan, made.folder / "made", made.store)
    if what == "workload":
        with pytest.raises(ValueError, match="finished runs of another study .*override.*: choose another --out"):
            refuse_other(plan, made.folder / "made")
    else:
        refuse_other(plan, made.folder / "made")
    made.asked = []
    made.measure(quick=what == "workload")
    assert len(made.asked) == 7


def test_one_measurement_of_other_software_among_new_ones_is_said(made: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made.measure()
    table = made.folder / "made" / TABLE
    old = json.loads(table.read_text())
    here = measurement.environment()
    monkeypatch.setattr(measurement, "environment", lambda: {**here, "versions": {**here["versions"], "numba": "0.1"}})
    made.measure()
    new = json.loads(table.read_text())
    for rows in (new["rows"][:1] + old["rows"][1:], old["rows"][:1] + new["rows"][1:]):
        table.write_text(json.dumps(new | {"rows": rows}))
        assert "numba" in again(made.plan(), made.folder / "made", made.folder / "another store")


def test_a_damaged_measurement_is_made_again(made: Any) -> None:
    made.measure()
    (file,) = made.store.glob("measurement/made-steps-100-s0-*/measured.json")
    file.write_text(file.read_text().replace('"seconds": 3.0', '"seconds": -3.0', 1))
    made.asked = []
    made.measure()
    assert made.asked == [("steps", 100, 0)]


@pytest.mark.parametrize("number", [-1.0, 1e101])
def test_no_time_and_no_error_is_impossible(number: float, made: Any) -> None:
    made.measure()
    (file,) = made.store.glob("measurement/made-steps-100-s0-*/measured.json")
    file.write_text(file.read_text().replace('"seconds": 3.0', f'"seconds": {number}', 1))
    with pytest.raises(ValueError, match=r"measured.json: seconds must be in 0..1e\+100"):
        measurement.read_measured(file.parent)


def test_what_cannot_be_measured_is_a_row_and_is_tried_again(made: Any) -> None:
    made.fails = ("way", "bb")
    rows = made.measure()
    (failed,) = [row for row in rows if row["state"] == "failed"]
    assert (failed["knob"], failed["setting"], failed["reason"]) == ("way", "bb", "it does not go")
    assert [point["setting"] for point in curves(made.subject(8), rows)] == [1, 10, 100, "a", None, 1.5, 22.75]
    made.fails, made.asked = None, []
    made.measure()
    assert made.asked == [("way", "bb", 0)]


def test_the_table_of_a_study_has_a_row_a_measurement(made: Any) -> None:
    made.measure()
    rows = json.loads((made.folder / "made" / TABLE).read_text())["rows"]
    assert rows[0]["parts.fit"] == rows[0]["seconds"] == 1.0
    assert (made.folder / "made" / CSV).read_text().splitlines()[0].startswith("run,knob,setting,seed,state")


def test_the_time_left_is_foretold_by_the_same_setting_then_by_the_same_subject(made: Any) -> None:
    costs, tasks = Costs(), {(t.config.name, t.config.setting): t for t in made.plan().tasks.values()}
    seconds = {("steps", 1): 10.0, ("steps", 100): 30.0, ("way", "bb"): 4.0}
    groups = [(tasks[place].group, spent) for place, spent in seconds.items()]
    for group, spent in [("other:steps 1", 1e4), ("other:x 1", 1e4), *groups]:
        costs.add("measurement", {"seconds": {"measure": spent}, "peak_bytes": 1, "bytes": 1, "work": 1.0,
                                  "pixels": 1.0, "group": group, "threads": 1})  # fmt: skip
    assert costs.predicted(tasks["steps", 100]).seconds == pytest.approx(30.0)
    assert costs.predicted(tasks["lone", 1.5]).seconds == pytest.approx(10.0)  # the median of all


def test_a_measurement_has_the_machine_to_itself() -> None:
    from novags.testbed.console.cores import cores_here

    assert (OneMachine.whole().places, OneMachine.whole().cores) == (1, cores_here())


def written(folder: Path, text: str) -> Path:
    (folder / "mine.toml").write_text(text)
    return folder / "mine.toml"


def test_a_study_of_ones_own_turns_some_knobs_through_some_of_their_settings(made: Any, tmp_path: Path) -> None:
    text = (
        '[measure]\nsubject = "made"\n[override]\nsize = 3\n[grid]\nsteps = [100, 10]\nway = ["none", "a"]\nseed = 7\n'
    )
    study = read_any(written(tmp_path, text))
    assert [tuple(cell.values.values()) for cell in study.cells] == [
        ("steps", 10, 7), ("steps", 100, 7), ("way", "a", 7), ("way", None, 7),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("made", "mad", r"\[override\]: what to measure must be one of .*did you mean 'made'"),
        ("size = 8", "", r"\[override\]: the sizes of made are size; got none"),
        ("size = 8", "sise = 8", r"the sizes of made are size; got sise"),
        ("size = 8", "size = 0", "size must be a whole number >= 1, got 0"),
        ("size = 8", "size = true", "size must be a whole number >= 1, got True"),
        ("seed = [0]", "step = 1", r"\[grid\]: unknown knob of made 'step'; did you mean 'steps'"),
        ("seed = [0]", "steps = [1, 10, 50]", "steps: 50 is not among its settings, 1, 10, 100"),
        ("seed = [0]", "steps = [1, 100]", "must be different ones and hold the default 10"),
        ("seed = [0]", "seed = [0, 0]", "seed: it must have values, each once"),
        ("seed = [0]", 'seed = ["a"]', "seed: it must be a whole number, got 'a'"),
        ("seed = [0]", "seed = -1", "seed must be >= 0"),
        ("[grid]", "[gird]", "unknown table or key 'gird'; did you mean 'grid'"),
        ("[measure]", "[measure]\nsize = 3", "unknown key 'size'"),
    ],
)
def test_a_mistake_in_a_study_is_one_line_with_its_place(
    old: str, new: str, said: str, made: Any, tmp_path: Path
) -> None:
    text = '[measure]\nsubject = "made"\n[override]\nsize = 8\n[grid]\nseed = [0]\n'.replace(old, new, 1)
    with pytest.raises(ValueError, match=rf"mine.toml: .*{said}") as error:
        read_any(written(tmp_path, text))
    assert "\n" not in str(error.value)


def test_a_size_that_nobody_has_is_refused(made: Any) -> None:
    with pytest.raises(ValueError, match="size must be a whole number >= 1"):
        sizes_of("made", {"size": 1 << 40})
