"""The planner hands each decision what it needs, and what the ones before it found; nothing is rendered."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sensor_model.plan import Effect
from simscenes import Optics, Rig, orbit_rig
from simscenes.job import render_set as rendering
from simscenes.loading.integrator import OwnIntegrator
from simscenes.loading.reference import SceneRef
from simscenes.transport import pilot, planner
from simscenes.transport.plan import EFFECTS, MADE_UP, TransportPlan

RIG = orbit_rig(9, 128, 96, 40, radius=3.0)
SOURCE = SceneRef.of("cornell")
OPTICS = Optics(aperture_radius=0.1, focus_distance=2.0, motion=0.5)
LOADED: Any = SimpleNamespace(scene="scene", rgb_alone=False, variant="wide_rgb", color="rgb", integrator=None)


def decision(name: str, on: bool = False, contribution: float = 0.0) -> Effect:
    unit = "px" if name in ("depth of field", "motion blur") else "of all light"
    return Effect(name=name, on=on, forced=False, contribution=contribution, bound=0.0, unit=unit, reason="found")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What every step of the planner was asked; the answers are fixed. There are media, and they are on."""
    calls: dict[str, Any] = {}

    def step(name: str, answer: Any) -> None:
        def told(*arguments: Any, **settings: Any) -> Any:
            calls[name] = (*arguments, *settings.values())
            return answer

        monkeypatch.setattr(planner, name, told)

    monkeypatch.setattr(planner, "using_variant", lambda backend: nullcontext(SimpleNamespace(Object=int)))
    monkeypatch.setattr(planner, "backend_of", lambda variant: f"{variant} backend")
    monkeypatch.setattr(planner, "geometry_channels", lambda mi, loaded, rig, i: (rig.width, i))
    monkeypatch.setattr(planner, "say_if_dark", lambda p: None)
    step("media_in", ["fog"])
    step("not_understood", [])
    step("check_wishes", None)
    step("light_weights", (0.25, 0.75))
    step("set_light_weights", None)
    step("media_effects", [decision("participating media", True), decision("chromatic media", False, 0.5)])
    step(
        "depth_effects", (16, [decision("indirect light", True, 0.3), decision("paths beyond max_depth", False, 0.001)])
    )
    step("roulette_effect", (5, decision("Russian roulette", True)))
    step(
        "color_effects", ([decision("polarisation", False, 0.002), decision("spectral transport", False, 0.004)], 0.07)
    )
    step("motion_effect", (decision("motion blur", False, 0.2), 16))
    step("patterned_sky", True)
    step("aperture_effect", decision("depth of field", False, 0.1))
    step("_measure_seconds", {"planned": 1.0})
    monkeypatch.setattr(pilot, "most_reflected", lambda mi, loaded: 0.8)
    return calls


def planned(**more: Any) -> TransportPlan:
    loaded = more.pop("loaded", LOADED)
    settings: dict[str, Any] = {"rig": RIG, "optics": OPTICS, "seed": 5, "variant": "wide"} | more
    return planner.plan_loaded(SOURCE, loaded, 0.03, **settings)


def test_decisions_follow_each_other(asked: dict[str, Any]) -> None:
    made = planned(force={"polarisation": False}, max_depth=7)
    p = asked["depth_effects"][0]
    assert (p.source, p.backend, p.allowed, p.seed) == (SOURCE, "wide backend", 0.03 / 5, 5)
    assert (p.rig.width, p.rig.height, len(p.rig)) == (32, 24, 3)
    views = [(32, 0), (32, 1), (32, 2)]
    assert asked["check_wishes"] == ({"polarisation": False}, 7, OPTICS, True, True)
    assert asked["light_weights"][2:] == (p.rig, 5)
    assert asked["set_light_weights"][1] == (0.25, 0.75)
    assert asked["depth_effects"] == (p, True, 0.8, 7)
    assert asked["roulette_effect"] == (p, True, 16, True, 4.0)
    assert asked["color_effects"] == (p, OPTICS, True, views, 0.3, True)
    assert asked["motion_effect"] == (views, RIG, p.rig, OPTICS, 4.0, True)
    assert asked["aperture_effect"] == (p, views, OPTICS, 4.0)
    assert sorted(made.names) == sorted(EFFECTS)
    assert (made.max_depth, made.rr_depth, made.subframes, made.light_weights) == (16, 5, 16, (0.25, 0.75))
    assert made["polarisation"].forced
    assert made.bound == pytest.approx(0.001 + 0.002 + 0.004 + 0.5)
    assert made.biases == {"px": pytest.approx(0.3), MADE_UP: 0.07}
    assert made.seconds == {"planned": 1.0}
    assert asked["_measure_seconds"][0] is p


def test_a_plan_without_measurements_takes_no_time(asked: dict[str, Any]) -> None:
    made = planned(measure=False)
    assert made.seconds == {}
    assert "_measure_seconds" not in asked
    assert asked["roulette_effect"][3] is asked["color_effects"][5] is False
    assert not any(effect.forced for effect in made.effects)


def test_a_scene_is_loaded_and_its_cameras_checked_before_it_is_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without cameras it gets eight usual ones, and without optics the lens of its own sensor."""
    done: list[Any] = []
    monkeypatch.setattr(planner, "using_variant", lambda variant: nullcontext(f"mi in {variant}"))
    monkeypatch.setattr(planner, "backend_of", lambda variant: "backend")
    loaded: Any = SimpleNamespace(variant="backend_spectral")
    asked: list[Any] = []
    monkeypatch.setattr(
        planner, "build_in_fewest_colors", lambda *a, **more: asked.append((*a, *more.values())) or loaded
    )
    monkeypatch.setattr(planner, "usual_rig", lambda *a: ("usual", *a))
    monkeypatch.setattr(planner, "check_cameras", lambda *a: done.append(a))
    monkeypatch.setattr(planner, "with_lens", lambda optics, loaded, mi: ("lens", optics))
    monkeypatch.setattr(planner, "plan_loaded", lambda *a, **settings: (a, settings))
    given, settings = planner.plan_transport("cornell", 0.1, seed=3, allow_outside=True, max_depth=9)
    usual = ("usual", SOURCE, loaded, 8, 64, 64)
    assert given == (SOURCE, loaded, 0.1)
    assert asked == [(SOURCE, "backend", True)]
    assert done == [("mi in backend_spectral", loaded, usual)]
    assert settings == {
        "rig": usual, "optics": ("lens", None), "force": None, "max_depth": 9, "measure": True, "variant": "auto",
        "seed": 3, "allow_outside": True,
    }  # fmt: skip
    assert planner.plan_transport("cornell", rig=RIG)[0][2] == 0.02
    assert done[1][2] is RIG


@pytest.mark.parametrize(
    ("spp", "target_error", "truth", "said"),
    [
        (2, None, 1.0, None),
        (1, None, 1.0, "spp must be >= 2"),
        (None, 0.5, 8.0, None),
        (None, 0.0, 1.0, "target_error"),
        (None, 1.0, 1.0, "target_error"),
        (None, float("nan"), 1.0, "target_error"),
        (2, 0.5, 1.0, "not both"),
        (None, None, 1.0, None),
        (2, None, 0.5, "truth_samples must be 1 to"),
        (2, None, float("nan"), "truth_samples must be 1 to"),
        (2, None, 1e9, "truth_samples must be 1 to"),
    ],
)
def test_quality_is_two_samples_or_a_share_and_truth_has_as_many_or_more(
    spp: int | None, target_error: float | None, truth: float, said: str | None
) -> None:
    if said is None:
        rendering._check_quality(spp, target_error, truth)
    else:
        with pytest.raises(ValueError, match=said):
            rendering._check_quality(spp, target_error, truth)


def test_a_job_plans_as_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    made = planner.default_plan(OPTICS)
    monkeypatch.setattr(rendering, "plan_loaded", lambda *a, **settings: (a, settings))

    def plan(wanted: Any) -> Any:
        return rendering._make_plan(SOURCE, LOADED, RIG, OPTICS, wanted, {"seed": 3})  # type: ignore[arg-type]

    assert plan("auto") == ((SOURCE, LOADED), {"rig": RIG, "optics": OPTICS, "seed": 3})
    assert plan("rgb").integrator() == made.integrator()
    assert plan("rgb").is_on("motion blur")
    assert plan(made) is made
    with pytest.raises(ValueError, match="plan must be 'auto', 'rgb'"):
        plan("best")


class Stop(Exception):
    """Ends a job where its plan is made."""


def test_a_job_whose_cameras_see_nothing_is_refused_before_it_is_planned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded, asked = SimpleNamespace(name="custom", digest="d", variant="rgb"), []
    monkeypatch.setattr(rendering, "build_in_fewest_colors", lambda *a, **settings: loaded)
    monkeypatch.setattr(rendering, "with_lens", lambda optics, loaded, mi: Optics())
    monkeypatch.setattr(rendering, "using_variant", lambda variant: nullcontext("mi"))
    monkeypatch.setattr(rendering, "_make_plan", lambda *a: pytest.fail("planned"))

    def check(*args: Any) -> None:
        asked.append(args)
        raise ValueError("inside of 'ball'")

    monkeypatch.setattr(rendering, "check_cameras", check)
    rig = orbit_rig(2, 8, 8, 40, radius=3.0)
    with pytest.raises(ValueError, match="inside of 'ball'"):
        rendering.render_set({"type": "scene"}, rig, tmp_path / "set")
    assert asked == [("mi", loaded, rig)]


@pytest.mark.parametrize(
    ("spp", "quality", "rows", "measured"),
    [(None, None, 977, True), (None, None, 976, False), (255, None, 977, False), (None, 0.01, 977, True)],
)
def test_long_jobs_measure_everything(
    spp: int | None, quality: float | None, rows: int, measured: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """12 views of 100 x 977 pixels at 256 samples, which stand for any error: 3.001e8; with 976 rows too few."""
    loaded = SimpleNamespace(name="custom", digest="d", variant="rgb")
    monkeypatch.setattr(rendering, "build_in_fewest_colors", lambda *a, **settings: loaded)
    monkeypatch.setattr(rendering, "with_lens", lambda optics, loaded, mi: Optics())
    monkeypatch.setattr(rendering, "check_cameras", lambda *a: None)
    monkeypatch.setattr(rendering, "using_variant", lambda variant: nullcontext("mi"))
    monkeypatch.setattr(rendering, "usual_rig", lambda source, loaded, *size: orbit_rig(12, 100, rows, 40, radius=3.0)
                        if size == (32, 128, 128) else None)  # fmt: skip
    told: list[Any] = []

    def make(source: Any, loaded: Any, rig: Rig, optics: Optics, plan: Any, wishes: dict[str, Any]) -> Any:
        told.extend((plan, wishes["measure"], wishes["seed"]))
        raise Stop

    monkeypatch.setattr(rendering, "_make_plan", make)
    with pytest.raises(Stop):
        rendering.render_set("cornell", None, tmp_path, spp=spp, target_error=quality, seed=4)
    assert told == ["auto", measured, 4]


def test_a_job_says_what_it_rendered_with() -> None:
    """Facts in set.json, besides what was asked and what each view came to."""
    watch = SimpleNamespace(with_earlier=lambda: {"load": 2.0})
    surfaces = SimpleNamespace(shapes=("floor", "ball"), materials=("paint",), demand="")
    job: Any = SimpleNamespace(surfaces=surfaces, rig=RIG, watch=watch, method=SimpleNamespace(variant="llvm_ad_rgb"))
    made = planner.default_plan(Optics())
    found = rendering._facts(job, made)
    assert (found["n_views"], found["width"], found["height"], found["kind"]) == (9, 128, 96, "rendered")
    assert (found["shapes"], found["materials"], found["seconds"]) == (["floor", "ball"], ["paint"], {"load": 2.0})
    assert found["integrator"] == made.integrator()
    assert np.isnan([found["plan"]["bound"], *found["left_out"]]).all()  # null in the file
    assert found["mitsuba_variant"] == "llvm_ad_rgb"


def test_layouts_are_written_into_folders_of_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[Any] = []

    def layout(name: str) -> Any:
        return SimpleNamespace(write=lambda views, out: written.append((name, out)))

    monkeypatch.setattr(rendering, "EXPORTS", {name: layout(name) for name in ("a", "b", "c")})
    views: Any = SimpleNamespace(path=tmp_path)
    assert rendering._exported(views, ("c", "a")) is views
    assert written == [("c", tmp_path / "c"), ("a", tmp_path / "a")]


def test_the_scenes_own_integrator_is_kept_unless_overridden(asked: dict[str, Any]) -> None:
    own = OwnIntegrator("path", max_depth=12, rr_depth=7, hide_emitters=True)
    loaded = SimpleNamespace(scene="scene", rgb_alone=False, variant="wide_rgb", color="rgb", integrator=own)
    made = planned(loaded=loaded)
    assert asked["depth_effects"][3] == 12
    assert (made.rr_depth, made.hide_emitters) == (7, True)
    assert asked["depth_effects"][0].hiding == {"hide_emitters": True}
    assert made["Russian roulette"].forced
    planned(loaded=loaded, max_depth=9)
    assert asked["depth_effects"][3] == 9
    other = SimpleNamespace(
        scene="scene", rgb_alone=False, variant="wide_rgb", color="rgb", integrator=OwnIntegrator("x", lost=("y",))
    )
    with pytest.warns(UserWarning, match="own integrator these are not kept: y; the plan chooses instead"):
        planned(loaded=other)
    plain = planner.default_plan(Optics(), own)
    assert plain.integrator() == {"type": "volpath", "max_depth": 12, "rr_depth": 7, "hide_emitters": True}


def test_all_that_a_scene_with_unknown_plugins_supports_is_on_with_the_reason() -> None:
    p: Any = SimpleNamespace(loads=lambda color: color == "spectral")
    names = ("indirect light", "paths beyond max_depth", "participating media", "spectral transport", "polarisation",
             "motion blur")  # fmt: skip
    found = planner.in_full([decision(name) for name in names], p, ["Fluff", "Stuff"])
    assert {effect.name: effect.on for effect in found} == dict(zip(names, (True,) * 4 + (False,) * 2, strict=True))
    assert {effect.reason for effect in found[:4]} == {"the planner does not know Fluff, Stuff: simulated fully"}
    assert found[5].reason == "found"
