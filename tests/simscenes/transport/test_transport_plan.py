"""What follows from decisions on effects: what each needs, the integrator, the colours, the bounds."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from sensor_model.plan import Effect
from simscenes import Optics
from simscenes.job import render_set as rendering
from simscenes.transport import pilot, planner
from simscenes.transport.plan import (
    APERTURE,
    DEEP,
    EFFECTS,
    INDIRECT,
    MADE_UP,
    MEDIA,
    MOTION,
    POLARISATION,
    ROULETTE,
    SPECTRAL,
    SPECTRAL_MIS,
    TransportPlan,
    settle,
)
from simscenes.transport.planner import default_plan, everything_on


def made(*on: str, **more: Any) -> TransportPlan:
    """A plan with some effects on. Effect k would cost 2^k thousandths; the blurs are in pixels."""
    effects = [
        Effect(
            name=name, on=name in on, forced=False, contribution=0.001 * 2**k, bound=0.004,
            unit="px" if name in (APERTURE, MOTION) else "of all light", reason="so found",
        )
        for k, name in enumerate(EFFECTS)
    ]  # fmt: skip
    settings = {"bound": 0.01, "unit": "of all light", "max_depth": 8, "rr_depth": 3} | more
    return TransportPlan(effects=tuple(effects), **settings)


def states(effects: Any) -> set[str]:
    return {e.name for e in effects if e.on}


@pytest.mark.parametrize(
    ("on", "force", "then"),
    [
        ((), {}, set()),
        ((DEEP,), {}, {DEEP, INDIRECT, ROULETTE}),
        ((SPECTRAL_MIS,), {}, {SPECTRAL_MIS, MEDIA}),
        ((POLARISATION,), {}, {POLARISATION, SPECTRAL}),
        ((), {POLARISATION: True}, {POLARISATION, SPECTRAL}),
        ((MEDIA, SPECTRAL_MIS), {POLARISATION: True}, {MEDIA, POLARISATION, SPECTRAL}),  # a wish comes first
        ((POLARISATION, MEDIA), {SPECTRAL_MIS: True}, {MEDIA, SPECTRAL_MIS}),
        ((SPECTRAL_MIS, POLARISATION), {}, {SPECTRAL_MIS, MEDIA}),  # of two plans, the first in the list
        ((DEEP, INDIRECT, ROULETTE), {ROULETTE: False}, {INDIRECT}),
        ((POLARISATION, SPECTRAL), {SPECTRAL: False}, set()),
        ((INDIRECT, MEDIA), {INDIRECT: False}, {MEDIA}),
    ],
)
def test_what_is_on_brings_or_gives_way_to_what_was_wished(
    on: tuple[str, ...], force: dict[str, bool], then: set[str]
) -> None:
    effects = settle(made(*on).effects, force)
    assert states(effects) == then
    assert [e.name for e in effects] == list(EFFECTS)
    assert {e.name for e in effects if e.forced} == set(force)
    for e in effects:
        if e.name in force:
            assert e.reason == "forced by name; so found"
        elif (e.name in on) == e.on:
            assert e.reason == "so found"
        else:
            assert e.reason.startswith("because ")


def test_the_reason_of_what_follows_is_said() -> None:
    given_up = settle(made(DEEP, INDIRECT, ROULETTE).effects, {ROULETTE: False})
    assert given_up[EFFECTS.index(DEEP)].reason == "because of Russian roulette, forced by name"
    brought = settle(made(POLARISATION).effects, {})
    assert brought[EFFECTS.index(SPECTRAL)].reason == "because polarisation is on"


@pytest.mark.parametrize(
    ("on", "kind", "max_depth", "rr_depth", "color"),
    [
        ((), "path", 2, 3, "rgb"),
        ((ROULETTE,), "path", 2, 3, "rgb"),
        ((INDIRECT,), "path", 8, 9, "rgb"),
        ((INDIRECT, ROULETTE), "path", 8, 3, "rgb"),
        ((INDIRECT, ROULETTE, DEEP), "path", -1, 3, "rgb"),
        ((DEEP,), "path", 2, 3, "rgb"),
        ((MEDIA, INDIRECT), "volpath", 8, 9, "rgb"),
        ((MEDIA, SPECTRAL_MIS, INDIRECT), "volpathmis", 8, 9, "rgb"),
        ((SPECTRAL_MIS, SPECTRAL, INDIRECT), "path", 8, 9, "spectral"),
        ((POLARISATION, SPECTRAL), "path", 2, 3, "spectral_polarized"),
    ],
)
def test_the_integrator_and_the_colours_follow(
    on: tuple[str, ...], kind: str, max_depth: int, rr_depth: int, color: str
) -> None:
    """Without roulette it starts beyond the longest path; without indirect light paths end at what lamps light."""
    plan = made(*on)
    assert plan.integrator() == {"type": kind, "max_depth": max_depth, "rr_depth": rr_depth}
    assert plan.color == color


def test_a_plan_changed_by_hand_has_no_bound_any_more() -> None:
    plan = made(INDIRECT, POLARISATION, SPECTRAL, biases={"px": 0.1}).force(on=[DEEP], off=[SPECTRAL])
    assert states(plan.effects) == {INDIRECT, DEEP, ROULETTE}
    assert math.isnan(plan.bound)
    assert plan.biases == {}
    with pytest.raises(ValueError, match="effect name"):
        plan.force(off=["magic"])


def test_what_a_plan_saves_is_printed() -> None:
    assert "million" not in str(made())
    text = str(made(seconds={"planned": 0.25, "everything on": 1.0}))
    assert text.startswith(str(made()))
    assert text.endswith("a million samples take 0.25 s planned, 1 s everything on: 4 times less time")


def test_numbers_that_json_cannot_hold_come_back() -> None:
    plan = made(INDIRECT, light_weights=(0.25, 0.75), seconds={"planned": 1.0}, subframes=4, tolerance=0.02)
    plan = replace(plan, rms={"polarisation": (0.1,) * 5})
    assert TransportPlan.from_dict(json.loads(json.dumps(plan.to_dict()))) == plan
    data = json.loads(json.dumps(plan.to_dict()))
    data["bound"] = data["effects"][1]["contribution"] = data["effects"][2]["bound"] = None
    del data["light_weights"]
    again = TransportPlan.from_dict(data)
    assert [math.isnan(e.contribution) for e in again.effects] == [k == 1 for k in range(9)]
    assert [math.isnan(e.bound) for e in again.effects] == [k == 2 for k in range(9)]
    assert math.isnan(again.bound)
    assert again.light_weights == ()


@pytest.mark.parametrize(("lens", "motion"), [(False, False), (True, False), (False, True)])
def test_without_pilots_everything_that_rgb_needs_is_on(lens: bool, motion: bool) -> None:
    optics = Optics(aperture_radius=0.1 if lens else None, focus_distance=2.0 if lens else None,
                    motion=0.5 if motion else None)  # fmt: skip
    plan = default_plan(optics)
    on = {INDIRECT, ROULETTE, MEDIA} | ({APERTURE} if lens else set()) | ({MOTION} if motion else set())
    assert states(plan.effects) == on
    assert set(plan.names) == set(EFFECTS)
    assert all(e.forced and math.isnan(e.contribution) and math.isnan(e.bound) for e in plan.effects)
    assert math.isnan(plan.bound)
    assert plan.integrator() == {"type": "volpath", "max_depth": 64, "rr_depth": 2}
    assert plan.subframes == (16 if motion else 1)
    assert plan.color == "rgb"


def test_the_bound_sums_what_is_left_out_in_each_unit() -> None:
    """Off are effects 1, 3, 4, 5, 6 of light: 2 + 8 + 16 + 32 + 64 thousandths, and both blurs: 128 + 256."""
    plan = planner._bounded(made(INDIRECT, ROULETTE, bound=0.0), None)
    assert plan.bound == pytest.approx(0.122)
    assert plan.biases == {"px": pytest.approx(0.384)}
    plan = planner._bounded(made(INDIRECT, ROULETTE, APERTURE), 0.07)
    assert plan.bound == pytest.approx(0.122)
    assert plan.biases == {"px": pytest.approx(0.256), MADE_UP: 0.07}
    # Spectra that the plan itself makes up are an error of light.
    plan = planner._bounded(made(INDIRECT, ROULETTE, SPECTRAL, APERTURE, MOTION), 0.07)
    assert plan.bound == pytest.approx(0.002 + 0.008 + 0.016 + 0.032 + 0.07)
    assert plan.biases == {"px": 0}
    assert planner._bounded(made(SPECTRAL), None).bound == pytest.approx(0.001 + 0.002 + 0.004 + 0.008 + 0.016 + 0.032)


def test_everything_on_holds_media_where_there_are_any() -> None:
    everything = everything_on(made())
    assert states(everything.effects) == {INDIRECT, SPECTRAL, POLARISATION, MEDIA}  # left out, but there
    assert everything.max_depth == 64
    none = made()
    empty = tuple(replace(e, contribution=0.0) if e.name == MEDIA else e for e in none.effects)
    assert MEDIA not in states(everything_on(replace(none, effects=empty)).effects)
    planned = tuple(replace(e, on=True, contribution=0.0) if e.name == MEDIA else e for e in none.effects)
    assert MEDIA in states(everything_on(replace(none, effects=planned)).effects)


def test_time_is_measured_for_the_plan_and_for_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seconds of a million samples; none where the scene cannot be had in spectra."""
    from contextlib import nullcontext

    asked: list[Any] = []

    def seconds(mi: Any, loaded: Any, rig: Any, integrator: dict[str, Any], seed: int) -> float:
        asked.append((mi, integrator["max_depth"], rig, seed))
        return 2e-6 if mi == "rgb" else 7e-6

    monkeypatch.setattr(pilot, "seconds_per_sample", seconds)
    p: Any = SimpleNamespace(
        colors=("rgb", "spectral", "spectral_polarized"),
        in_color=lambda c: nullcontext((c, "loaded")),
        rig="rig",
        seed=3,
    )
    found = planner._measure_seconds(p, made(INDIRECT))
    assert found == {"planned": pytest.approx(2), "everything on": pytest.approx(7)}
    assert asked == [("rgb", 8, "rig", 3), ("spectral_polarized", 64, "rig", 3)]
    p.colors = ("rgb",)
    assert planner._measure_seconds(p, made(INDIRECT)) == {}


@pytest.mark.parametrize("tolerance", [0.0, 1.0, -0.1, math.nan])
def test_a_tolerance_that_is_no_share_is_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        planner.plan_loaded(None, None, tolerance, rig=None, optics=Optics())  # type: ignore[arg-type]


def test_the_method_of_a_job_is_that_of_its_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lens and motion only if they are on; the scene is loaded again for other colours, and gets the plan's lights."""
    from contextlib import nullcontext

    weighed: list[Any] = []
    monkeypatch.setattr(rendering, "build_scene", lambda source, mi, allow_outside: ("again", mi.color, allow_outside))
    monkeypatch.setattr(rendering, "set_light_weights", lambda loaded, weights, mi: weighed.append((loaded, weights)))
    monkeypatch.setattr(rendering, "using_variant", lambda variant, color: nullcontext(
        SimpleNamespace(color=color, variant=lambda: f"{variant}_{color}", load_dict=lambda d: d)
    ))  # fmt: skip
    optics = Optics(aperture_radius=0.1, focus_distance=2.0, motion=0.5, camera="Nikon 5100 (NPL)")

    loaded: Any = SimpleNamespace(color="rgb")

    def method(*on: str) -> Any:
        plan = made(*on, subframes=16, light_weights=(0.25, 0.75))
        return rendering._method("source", loaded, "llvm_ad", plan, optics, 7, True)  # type: ignore[arg-type]

    plain = method(INDIRECT)
    assert plain.optics == Optics(motion=0.5, camera="Nikon 5100 (NPL)")
    assert (plain.subframes, plain.seed, plain.variant, plain.loaded) == (1, 7, "llvm_ad_rgb", loaded)
    assert plain.integrator == {"type": "path", "max_depth": 8, "rr_depth": 9}
    assert method(APERTURE).optics == optics
    assert method(MOTION).subframes == 16
    assert method(SPECTRAL).loaded == ("again", "spectral", True)
    assert method(SPECTRAL).variant == "llvm_ad_spectral"
    assert weighed[0] == (loaded, (0.25, 0.75))
    assert weighed[-1] == (("again", "spectral", True), (0.25, 0.75))


def test_where_omitted_light_lies_is_summed_over_all_omitted_effects_and_even_where_not_known() -> None:
    names = made().names
    off = [name for name in names if name not in (APERTURE, MOTION)]  # blurs are no light
    known = {off[0]: (0.1, 0.2, 0.3, 0.4, 0.5), off[1]: (1.0, 2.0, 3.0, 4.0, 5.0), APERTURE: (9.0,) * 5}
    even = sum(e.contribution for e in made().effects if e.name in off[2:])
    assert made(rms=known).bias == pytest.approx([1.1 * k + even for k in range(1, 6)])
    assert made(*off).bias == (0.0,) * 5
    assert all(math.isnan(value) for value in made(bound=math.nan).bias)
