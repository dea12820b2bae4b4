"""Claims about the plan of a study: what is shared, what a key depends on, what is refused, what it will take."""

import io
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.cameras.sources.vggt import VggtConfig
from novags.methods.variant import Variant
from novags.testbed.console.terminal import Console
from novags.testbed.ledger import store
from novags.testbed.ledger.code import Code
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig, files_of
from novags.testbed.study import conduct, entry
from novags.testbed.study.cells.grid import read_study
from novags.testbed.study.costs import Costs, default, longest_after, time_left
from novags.testbed.study.engines.choice import OneMachine
from novags.testbed.study.forecast import forecast
from novags.testbed.study.knobs.measurement import Measurement
from novags.testbed.study.plan import Planner, StudyPlan, plan_of
from novags.testbed.study.simulate import makespan
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

QUIET = Console(quiet=True)
GRID = """
[grid]
scene = ["cornell", "tabletop"]
electrons = [5, 20]
method = ["naive", "oracle"]
seed = [0, 1]
"""


def plan(tmp_path: Path, text: str = GRID) -> StudyPlan:
    (tmp_path / "study.toml").write_text(text)
    return plan_of(read_study(tmp_path / "study.toml"), tmp_path / "store", QUIET)


def photographs(folder: Path, seed: int = 0) -> Path:
    names, rng = [f"{i:04d}" for i in range(9)], np.random.default_rng(seed)
    write_cameras(folder, names, orbit_rig(9, 24, 24, 50.0, radius=3.0))
    for name in names:
        write_png(folder / "images" / f"{name}.png", rng.integers(20, 250, (24, 24, 3)).astype(np.uint8))
    return folder


def test_stages_that_runs_share_are_planned_once(tmp_path: Path) -> None:
    found = plan(tmp_path)
    kinds = [task.kind for task in found.tasks.values()]
    assert {kind: kinds.count(kind) for kind in kinds} == {"set": 2, "capture": 8, "run": 16}
    for cell, key in found.runs:
        render, capture, run = found.above(key)
        assert render.config == cell.preset.render
        assert capture.config == cell.preset.capture
        assert run.config.variant.name == cell.values["method"]
    seen: set[str] = set()
    for key, task in found.tasks.items():  # what a task needs comes before it
        assert seen >= set(task.needs)
        seen.add(key)


def test_what_runs_share_is_made_and_hashed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hashed, made = Counter[str](), list[str]()

    def key_of(kind: str, recipe: dict[str, Any], code: Code) -> str:
        hashed[kind] += 1
        return store.key_of(kind, recipe, code)

    def config(variant: Variant, default: Any, shared: Mapping[str, Any]) -> Any:
        made.append(variant.name)
        return original(variant, default, shared)

    original = Variant.config
    monkeypatch.setattr("novags.testbed.study.plan.key_of", key_of)
    monkeypatch.setattr(Variant, "config", config)
    found = plan(tmp_path, f"{GRID.replace('[0, 1]', str(list(range(20))))}[override]\niterations = 123\n")
    assert len(found.runs) == 160
    assert hashed == {"set": 2, "capture": 80, "run": 160}
    assert len(made) < 20  # of the two methods, and of those of the preset


def test_a_key_stays_the_same_and_changes_with_settings_above_it_and_with_its_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = plan(tmp_path)
    assert list(plan(tmp_path).tasks) == list(first.tasks)
    finer = plan(tmp_path, f"{GRID}[override]\nspp = 8")
    assert not finer.tasks.keys() & first.tasks.keys()
    longer = plan(tmp_path, f"{GRID}[override]\niterations = 7")
    assert [task.kind for key, task in longer.tasks.items() if key in first.tasks] == ["set", *["capture"] * 4] * 2
    monkeypatch.setattr(CaptureConfig, "code", Code({"capturing.py": "another version"}, {}))
    other = plan(tmp_path)
    assert {first.tasks[key].kind for key in other.tasks.keys() & first.tasks.keys()} == {"set"}


def test_files_that_parameters_name_count_by_their_content(tmp_path: Path) -> None:
    """Rationale: the files of the first value stood for those of all, so that a changed one went unnoticed."""
    (tmp_path / "s.xml").write_text(
        "<scene version='3.0.0'><default name='file' value='a.png'/><shape type='sphere'><bsdf type='diffuse'>"
        "<texture type='bitmap' name='reflectance'><string name='filename' value='$file'/></texture></bsdf></shape>"
        "</scene>"
    )
    text = "[grid]\nscene = 's.xml'\nparameters = ['file=a.png', 'file=b.png']\nmethod = 'naive'"
    for name in "ab":
        write_png(tmp_path / f"{name}.png", np.zeros((4, 4, 3), np.uint8))
    before = [key for _, key in plan(tmp_path, text).runs]
    write_png(tmp_path / "b.png", np.ones((4, 4, 3), np.uint8))
    after = [key for _, key in plan(tmp_path, text).runs]
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False]


@pytest.mark.parametrize("stage", ["render", "capture"])
def test_an_entry_without_the_layouts_that_are_asked_for_is_another_one(tmp_path: Path, stage: str) -> None:
    """Rationale: it was taken for complete, and the layouts were never written."""
    first = plan(tmp_path).tasks
    export = f"{GRID}[override]\n{stage}.export = "
    asked = plan(tmp_path, f"{export}['llff', 'blender']").tasks
    assert not {key for key in asked.keys() & first.keys() if first[key].kind == {"render": "set"}.get(stage, stage)}
    assert list(asked) == list(plan(tmp_path, f"{export}['blender', 'llff']").tasks)


def test_weights_that_are_replaced_under_their_name_make_other_runs(tmp_path: Path) -> None:
    text = "[grid]\nmethod = 'sci-gs'\n[override]\nenhance.weights = 'w.pt'"
    (tmp_path / "w.pt").write_bytes(b"first")
    first = plan(tmp_path, text)
    assert list(plan(tmp_path, text).tasks) == list(first.tasks)
    (tmp_path / "w.pt").write_bytes(b"other")
    kept = plan(tmp_path, text).tasks.keys() & first.tasks.keys()
    assert [first.tasks[key].kind for key in first.tasks if key in kept] == ["set", "capture"]


def test_keys_do_not_depend_on_how_the_study_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = """
    [grid]
    method = ["sci-gs", "mine"]
    cameras = "known"
    [override]
    enhance.weights = "w.pt"
    [variant.mine]
    method = "zero-dce-gs"
    enhance.weights = ["w.pt"]
    """
    folder = tmp_path / "studies"
    folder.mkdir()
    (folder / "w.pt").write_bytes(b"weights")
    (folder / "study.toml").write_text(text)
    keys = []
    for place, name in ((folder, "study.toml"), (tmp_path, "studies/study.toml"), (tmp_path, folder / "study.toml")):
        monkeypatch.chdir(place)
        keys.append(list(plan_of(read_study(Path(name)), tmp_path / "store", QUIET).tasks))
    assert keys[0] == keys[1] == keys[2]
    monkeypatch.chdir(folder)
    (folder / "study.toml").write_text("[grid]\nmethod = 'naive'\ncameras = 'vggsfm:home=clone,checkpoint=w.pt'")
    assert read_study(Path("study.toml")).cells[0].preset.cameras.checkpoint == folder / "w.pt"


def test_the_checkpoint_of_a_camera_source_counts_by_its_content(tmp_path: Path) -> None:
    checkpoint = tmp_path / "vggt.safetensors"
    checkpoint.write_bytes(b"first")
    config = ReconstructConfig(variant=Variant(name="naive", method="naive"), cameras=VggtConfig(checkpoint=checkpoint))
    first = files_of(config)
    checkpoint.write_bytes(b"other")
    assert first.keys() == files_of(config).keys() == {"cameras.checkpoint: vggt.safetensors"}
    assert first != files_of(config)


def test_a_set_that_is_there_is_photographed_and_its_content_counts(tmp_path: Path) -> None:
    photographs(tmp_path / "photos")
    text = "[grid]\nscene = 'photos'\nelectrons = [5, 20]\nmethod = 'naive'"
    first = plan(tmp_path, text)
    assert [task.kind for task in first.tasks.values()] == ["capture", "run"] * 2
    assert {task.source for task in first.tasks.values() if task.kind == "capture"} == {tmp_path / "photos"}
    assert list(plan(tmp_path, text).tasks) == list(first.tasks)
    photographs(tmp_path / "photos", seed=1)
    assert not plan(tmp_path, text).tasks.keys() & first.tasks.keys()


WRONG = {
    "the same run": (
        '[grid]\nmethod = "naive"\ndevice = ["auto", "cpu"]',
        r"\[grid\]: \(method naive, device auto, seed 0\) and \(method naive, device cpu, seed 0\) are the same run",
    ),
    "too small": (
        "[grid]\nmethod='naive'\n[override]\nwidth = 20",
        "method naive, seed 0: width and height must be >= 22",
    ),
    "vggt": ("[grid]\nmethod='naive'\ncameras=['vggt:checkpoint=none.safetensors']", "cameras vggt:checkpoint=none"),
    "no set": ("[grid]\nscene='empty'\nmethod='naive'", "scene empty, method naive, seed 0: "),
    "weights": ("[grid]\nmethod=['naive', 'mbllen-gs']", "mbllen-gs, seed 0: mbllen-gs: MBLLEN has no weights"),
    "surface": (
        "[grid]\nscene='photos'\nmethod=['averaging']",
        "averaging follows the true surface, which is not known of photo",
    ),
    "gpu": ("[grid]\nmethod='naive'\ndevice='gpu'", "device must be one of auto, cpu, cuda, got 'gpu'"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_cannot_work_is_refused_before_anything_runs(tmp_path: Path, what: str) -> None:
    (tmp_path / "empty").mkdir()
    photographs(tmp_path / "photos")
    text, said = WRONG[what]
    with pytest.raises(ValueError, match=said) as error:
        plan(tmp_path, text)
    assert str(error.value).startswith(str(tmp_path / "study.toml"))
    assert len(str(error.value).splitlines()) == 1


def test_a_set_takes_the_memory_of_one_wavefront_of_its_largest_view(tmp_path: Path) -> None:
    """Held-out views are the largest; beyond 2^22 samples nothing more is traced at once."""

    def peak(spp: int) -> float:
        found = plan(tmp_path, f"{GRID}[override]\nwidth = 64\nheight = 64\nspp = {spp}")
        (peak,) = {task.memory for task in found.tasks.values() if task.kind == "set"}
        (worth,) = {task.config.truth_samples for task in found.tasks.values() if task.kind == "set"}
        assert worth == 8
        return peak

    assert peak(32) - peak(16) == pytest.approx(100 * 64 * 64 * 16 * 8)
    assert peak(4096) == peak(8192) == pytest.approx(6e8 + 100 * 2**22)


@pytest.mark.parametrize(("kind", "expected"), [("set", 7), ("run", 12)])
def test_a_peak_counts_once_and_with_it_the_program_that_ran_beside(kind: str, expected: int, tmp_path: Path) -> None:
    """A set's record says the peak of the very process that its stage measured."""
    record = {"stage": {"peak_bytes": 7, "seconds": 1.0}, "peak_bytes": 5}
    (tmp_path / "record.json").write_text(json.dumps(record))
    order: Any = SimpleNamespace(task=entry.Task(kind, "k", "n", None), folder=tmp_path, threads=1)
    steps = {"render": entry.StageStep(lambda: None, "record.json")}
    assert entry._cost(order, steps)["peak_bytes"] == expected


def test_the_forecast_counts_what_is_there_and_writes_nothing(tmp_path: Path) -> None:
    found = plan(tmp_path)
    (first,) = [task for task in found.tasks.values() if task.kind == "set" and "cornell" in task.name]
    folder = first.folder(tmp_path / "store")
    folder.mkdir(parents=True)
    store.write_seal(folder, first.key, {}, {"seconds": {"render": 50.0}, "peak_bytes": 10**9, "group": first.group,
                                             "work": first.work, "pixels": first.pixels, "threads": 1}, ())  # fmt: skip
    before = sorted(tmp_path.rglob("*"))
    text = forecast(found, tmp_path / "store", OneMachine(2, 1))
    assert sorted(tmp_path.rglob("*")) == before
    rows = {line.split()[0]: line.split()[1:4] for line in text.splitlines() if line.startswith(("  set", "  capture"))}
    assert rows == {"set": ["2", "1", "1"], "capture": ["8", "0", "8"]}
    assert "16 runs = 2 scene x 2 electrons x 2 method x 2 seed" in text
    assert "50 s" in next(line for line in text.splitlines() if line.startswith("  set"))  # as the other one took
    assert "other studies" not in text
    assert "holds 1 entries of other studies" in forecast(
        plan(tmp_path, f"{GRID}[override]\nspp=8"), tmp_path / "store", OneMachine(2, 1)
    )


def test_measured_costs_correct_predictions_by_the_most_alike(tmp_path: Path) -> None:
    found = plan(tmp_path)
    runs = [task for task in found.tasks.values() if task.kind == "run"]
    naive, oracle = (next(task for task in runs if task.group == group) for group in ("naive", "oracle"))
    costs = Costs()
    expected = default("run", naive.work, naive.pixels, naive.memory)
    assert costs.predicted(naive) == expected
    for factor in (3.0, 2.0, 50.0):  # the median counts
        costs.add("run", {"seconds": {"a": factor * expected.seconds / 2, "b": factor * expected.seconds / 2},
                          "peak_bytes": 4 * expected.memory, "bytes": 5 * expected.disk, "group": "naive",
                          "work": naive.work, "pixels": naive.pixels, "memory": naive.memory,
                          "threads": 1})  # fmt: skip
    assert costs.predicted(naive).seconds == pytest.approx(3 * expected.seconds)
    assert costs.predicted(oracle).seconds == pytest.approx(3 * expected.seconds)  # nothing is more alike
    costs.add("run", {"seconds": {"a": 7 * expected.seconds}, "peak_bytes": 1, "bytes": 1, "group": "oracle",
                      "work": naive.work, "pixels": naive.pixels, "memory": naive.memory,
                          "threads": 1})  # fmt: skip
    assert costs.predicted(oracle).seconds == pytest.approx(7 * expected.seconds)
    assert costs.predicted(naive).memory == pytest.approx(4 * expected.memory)


def test_time_is_shared_by_workers_but_no_shorter_than_the_longest_chain(tmp_path: Path) -> None:
    found = plan(tmp_path)
    seconds = {key: {"set": 100.0, "capture": 10.0, "run": 20.0}[task.kind] for key, task in found.tasks.items()}
    total = 2 * 100 + 8 * 10 + 16 * 20
    assert time_left(found, seconds, 2) == total / 2
    assert time_left(found, seconds, 100) == 130
    assert makespan(found, seconds, 1) == total
    assert makespan(found, seconds, 2) == total / 2
    assert makespan(found, seconds, 100) == 130
    assert {round(v) for v in longest_after(found, seconds).values()} == {130, 30, 20}


def test_programs_of_two_names_are_two_methods(tmp_path: Path) -> None:
    """The same command: they may differ by what they find at hand."""
    program = 'command = "true {capture} {out}"'
    text = f'[grid]\nmethod = ["mine", "yours"]\n[method.mine]\n{program}\n[method.yours]\n{program}\n'
    found = plan(tmp_path, text)
    assert len({key for _, key in found.runs}) == 2


def test_a_measurement_is_another_one_with_another_seed_setting_or_size(tmp_path: Path) -> None:
    planner, base = Planner(tmp_path, QUIET), Measurement("sensor", (("side", 24),), "light", "float32", 0)
    others = (replace(base, seed=1), replace(base, setting="float64"), replace(base, name="precision"),
              replace(base, sizes=(("side", 25),)))  # fmt: skip
    keys = [planner.measurement(one) for one in (base, *others)]
    assert len(set(keys)) == 5
    assert planner.measurement(base) == keys[0]


def test_all_runs_of_a_study_are_its_ends(tmp_path: Path) -> None:
    found = plan(tmp_path)
    assert found.ends == {key for key, task in found.tasks.items() if task.kind == "run"}


def test_every_finished_entry_counts_in_what_others_will_cost() -> None:
    """The median of those that are most alike is thrice the guess: it is none of four of them."""
    guess = default("run", 100.0, 10.0)
    entries = [{"kind": "run", "group": "naive", "threads": 1, "work": 100.0, "pixels": 10.0,
                "peak_bytes": guess.memory, "bytes": 1,
                "seconds": {"fit": factor * guess.seconds / 2, "render": factor * guess.seconds / 2}}
               for factor in (2.0, 4.0, 3.0, 1.0, 9.0)]  # fmt: skip
    costs = Costs.of(entries, {"run": 1})
    task: Any = SimpleNamespace(kind="run", group="naive", work=100.0, pixels=10.0, memory=0.0, disk=0.0)
    assert costs.predicted(task).seconds == pytest.approx(3 * guess.seconds)
    assert costs.known(task)
    assert not Costs.of([], {}).known(task)


def test_time_left_of_a_task_under_way_is_at_least_what_its_own_pace_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a fit of a network forecast at 7 minutes said "0 s left" for an hour."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(conduct.time, "monotonic", lambda: clock.now)
    costs: Any = SimpleNamespace(predicted=lambda task: SimpleNamespace(seconds=60.0))
    plan: Any = SimpleNamespace(tasks={"a": None, "b": None})
    watch = conduct._Watch(plan, None, costs, 1, None, known=set())  # type: ignore[arg-type]
    watch.started("a")
    assert watch.seconds_left() == {"a": 60.0, "b": 60.0}
    watch.progress("a", "reconstruct", 500, 7500, "")
    clock.now = 150.0
    assert watch.seconds_left()["a"] == 10.0  # no step is done yet: as forecast
    watch.progress("a", "reconstruct", 600, 7500, "")
    assert watch.seconds_left()["a"] == pytest.approx(6900 * 50 / 100)  # half a second a step
    clock.now = 190.0
    watch.progress("a", "render", 0, 4, "")
    clock.now = 192.0
    watch.progress("a", "render", 1, 4, "")
    assert watch.seconds_left()["a"] == pytest.approx(6.0)  # the new stage's pace, not the old one's
    watch.progress("a", "render", 0, 4, "")  # the next scene, begun again: the count starts anew
    assert watch.seconds_left() == {"a": 0.0, "b": 60.0}


def test_folders_that_a_program_is_given_and_that_do_not_count_are_said(tmp_path: Path) -> None:
    """Rationale: a run was kept as unchanged though the weights that the command names had changed."""
    (tmp_path / "weights").mkdir()
    said = io.StringIO()
    for files in ("", 'files = ["weights"]'):
        program = f'command = "true --weights weights {{capture}} {{out}}"\n{files}'
        (tmp_path / "study.toml").write_text(f'preset = "demo"\n[grid]\nmethod = "mine"\n[method.mine]\n{program}\n')
        plan_of(read_study(tmp_path / "study.toml"), tmp_path / "store", Console(stream=said))
    (line,) = said.getvalue().splitlines()
    assert line.startswith("note: mine: its command names the folder weights, and a change in that makes no run again")
    assert line.endswith('if it is read, name it in files (files = ["weights"])')
