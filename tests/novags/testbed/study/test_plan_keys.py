"""Claims about the keys of a plan: every part that a result depends on makes it another one."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.methods.variant import Variant
from novags.testbed.console.terminal import Console
from novags.testbed.ledger.code import Code
from novags.testbed.stages.configs.command import CommandConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.configs.posing import PosesConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.study import plan as module
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.knobs.measurement import Measurement
from novags.testbed.study.plan import Planner, StudyPlan
from simscenes.sets.pictures.png import write_png

QUIET = Console(quiet=True)


@pytest.fixture
def planner(tmp_path: Path) -> Planner:
    return Planner(tmp_path / "store", QUIET)


def picture(file: Path, seed: int) -> None:
    write_png(file, np.random.default_rng(seed).integers(0, 255, (8, 8, 3)).astype(np.uint8))


def test_a_run_has_the_key_of_its_name_settings_files_and_capture(
    planner: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    def keyed(name: str = "a", electrons: float = 5.0, **settings: str) -> str:
        variant = Variant(name=name, method="naive", settings=settings)
        return planner.run(adapted(EXPERIMENTS["demo"], variants=(variant,), methods=(name,), electrons=electrons))

    found = [keyed(), keyed("b"), keyed(electrons=6.0), keyed(**{"fit.dssim_weight": "0.1"})]
    monkeypatch.setattr(module, "files_of", lambda config: {"weights: w.pt": "x"})
    found.append(keyed())
    monkeypatch.undo()
    assert len(set(found)) == 5
    assert keyed() == found[0]


def test_a_program_has_the_key_of_its_name_request_and_capture(planner: Planner, tmp_path: Path) -> None:
    def keyed(captured: str, seed: int = 0, name: str = "mine") -> str:
        config = CommandConfig(name=name, command="true {capture} {out}", folder=tmp_path, seed=seed)
        return planner._command(config, captured)

    captures = [planner.capture(adapted(EXPERIMENTS["demo"], electrons=electrons)) for electrons in (5.0, 6.0)]
    found = [keyed(captures[0]), keyed(captures[1]), keyed(captures[0], 1), keyed(captures[0], 0, "yours")]
    assert len(set(found)) == 4
    assert keyed(captures[0]) == found[0]


def test_a_measurement_has_the_key_of_its_request_and_of_the_capture_of_its_seed(
    planner: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[int]()
    base = Measurement("sensor", (("side", 24),), "light", "float32", 0)

    def keyed(config: Measurement, electrons: float = 5.0) -> str:
        def pictured(seed: int) -> Any:
            asked.append(seed)
            return adapted(EXPERIMENTS["demo"], electrons=electrons, seed=seed)

        subject = replace(base.subject, pictured=pictured)
        monkeypatch.setattr(Measurement, "subject", property(lambda self: subject))
        try:
            key = planner.measurement(config)
        finally:
            monkeypatch.undo()
        assert [planner.tasks[need].config.seed for need in planner.tasks[key].needs] == [config.seed]
        return key

    found = [keyed(base), keyed(base, 6.0), keyed(replace(base, seed=3)), keyed(replace(base, setting="float64"))]
    assert len(set(found)) == 4
    assert keyed(base) == found[0]
    assert asked == [0, 0, 3, 0, 0]


@pytest.mark.parametrize("change", ["config", "inputs", "scene", "code"])
def test_an_import_has_the_key_of_its_request_inputs_scene_and_code(
    change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs = {"dark": "x", "dataset": None}
    rig = SimpleNamespace(width=8, height=6)
    material = SimpleNamespace(dark=SimpleNamespace(source=SimpleNamespace(views=[1, 2], rig=rig)),
                               inputs=lambda: dict(inputs))  # fmt: skip
    monkeypatch.setattr(module, "material_of", lambda *_: material)

    def keyed(name: str = "dark", **settings: Any) -> str:
        return Planner(tmp_path / "store", QUIET)._imported(tmp_path / name, ImportConfig(**settings))

    first = keyed()
    assert keyed() == first
    if change == "inputs":
        inputs["dark"] = "y"
    if change == "code":
        monkeypatch.setattr(ImportConfig, "code", Code({"other": "code"}, {}))
    assert keyed(*(["other"] if change == "scene" else []), **({"black": 3.0} if change == "config" else {})) != first


def test_photographs_have_the_key_of_their_request_and_of_all_of_them_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos = tmp_path / "photos"
    for k in range(4):
        picture(photos / f"{k}.png", k)

    def keyed(**settings: Any) -> str:
        return Planner(tmp_path / "store", QUIET)._posed(PosesConfig(photographs=photos, **settings))

    found = [keyed()]
    (tmp_path / "beside.txt").write_text("no photograph")
    assert keyed() == found[0]
    found.append(keyed(seed=3))
    picture(photos / "3.png", 9)
    found.append(keyed())
    monkeypatch.setattr(PosesConfig, "code", Code({"other": "code"}, {}))
    found.append(keyed())
    assert len(set(found)) == 4


def test_a_set_and_a_capture_have_the_keys_of_all_that_they_are_made_with(
    planner: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same text of a request and of its inputs is hashed once; another kind of entry is another one."""
    config = RenderConfig(scene="cornell")
    found = [planner._key("set", config, {"scene": "x"}), planner._key("capture", config, {"scene": "x"}),
             planner._key("set", config, {"scene": "y"}),
             planner._key("set", replace(config, spp=3), {"scene": "x"})]  # fmt: skip
    again = Planner(planner.store, QUIET)
    found.append(again._key("set", config, {"scene": "x"}, ("novags.testbed.stages.posing",)))
    monkeypatch.setattr(module, "_layouts", lambda config: {"export": ["llff"]})
    found.append(Planner(planner.store, QUIET)._key("set", config, {"scene": "x"}))
    monkeypatch.setattr(RenderConfig, "code", Code({"other": "code"}, {}))
    found.append(Planner(planner.store, QUIET)._key("set", config, {"scene": "x"}))
    assert len(set(found)) == 7
    assert planner._key("set", config, {"scene": "x"}) == found[0]


def test_the_ends_of_a_plan_are_all_its_runs() -> None:
    nothing: Any = None
    assert StudyPlan(nothing, {}, ((nothing, "a"), (nothing, "b"), (nothing, "c"))).ends == {"a", "b", "c"}


def test_what_a_task_needs_comes_before_it_at_any_depth_and_every_named_knob_stays() -> None:
    needs = {"a": (), "b": (), "c": ("a", "b"), "d": ("c", "b"), "e": ()}
    tasks: Any = {key: SimpleNamespace(key=key, needs=each) for key, each in needs.items()}
    cells: Any = [(SimpleNamespace(values={"knob": knob}), key) for knob, key in (("x", "d"), ("y", "e"), ("z", "c"))]
    study: Any = SimpleNamespace(axes={"knob": ("x", "y", "z")}, table={"measure": {"subject": "s"}})
    plan = StudyPlan(study, tasks, tuple(cells))
    assert [task.key for task in plan.above("d")] == ["a", "b", "c", "b", "d"]
    kept = plan.only(["x", "y"], ())
    assert [key for _, key in kept.runs] == ["d", "e"]
    assert set(kept.tasks) == {"a", "b", "c", "d", "e"}
    assert [key for _, key in plan.only(["y"], {"c"}).runs] == ["e", "c"]
    assert set(plan.only(["y"], ()).tasks) == {"e"}
