"""The error that a render claims covers noise and what the plan leaves out, and says so before it starts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sensor_model.plan import Effect
from simscenes import Optics
from simscenes.job.accuracy import AT_MOST, claimed, noise_limits, noise_target, summary, warnings_about
from simscenes.transport import pilot
from simscenes.transport.plan import EFFECTS, MOTION, TransportPlan
from simscenes.transport.planner import default_plan


def plan(bound: float = 0.0, rms: tuple[float, ...] = (0.0,) * 5) -> TransportPlan:
    """Paths beyond the depth are left out; everything else is on."""
    effects = tuple(
        Effect(name=name, on=name != "paths beyond max_depth", forced=False, contribution=bound, bound=0.004,
               unit="of all light", reason="max_depth 64") for name in EFFECTS
    )  # fmt: skip
    return TransportPlan(
        effects=effects, bound=bound, unit="of all light", max_depth=64, rr_depth=2, tolerance=0.02,
        rms={"paths beyond max_depth": rms, "indirect light": (9.0,) * 5},
    )  # fmt: skip


def test_noise_is_told_for_each_quarter_by_its_own_light() -> None:
    """16 pixels of 1 to 16, mixed, each with a variance of 4: of the darkest four the mean is 2.5."""
    light = np.random.default_rng(0).permutation(np.arange(1.0, 17)).reshape(4, 4)
    channels = {c: light for c in "RGB"} | {f"half.{c}": np.full((4, 4), -2.0) for c in "RGB"}
    assert noise_limits(channels) == pytest.approx([2 / 8.5, 2 / 2.5, 2 / 6.5, 2 / 10.5, 2 / 14.5])
    black = {c: np.zeros((4, 4)) for c in channels}
    assert noise_limits(black) == [0.0] * 5


def test_a_dark_pixel_has_its_own_noise_and_not_its_neighbours() -> None:
    """A dark, quiet half beside a bright, loud one: every second pixel."""
    bright = np.indices((8, 8)).sum(0) % 2 == 1
    channels = {c: np.where(bright, 10.0, 1.0) for c in "RGB"} | {
        f"half.{c}": np.where(bright, 5.0, 0.1) for c in "RGB"
    }
    channels |= {f"var.{c}": np.full((8, 8), 12.5) for c in "RGB"}  # what neighbours share
    assert noise_limits(channels)[1:] == pytest.approx([0.1, 0.1, 0.5, 0.5])


def test_the_stated_noise_is_seldom_below_the_error_of_the_picture_and_below_half_more() -> None:
    """500 pictures of 32 x 32 whose pixels have exponential variances: both figures scatter."""
    rng, above, ratios = np.random.default_rng(3), 0, []
    for _ in range(500):
        deviation = np.sqrt(rng.exponential(0.01, (32, 32, 1)))
        one, other = rng.normal(1.0, np.sqrt(2) * deviation, (2, 32, 32, 3))
        picture, half = (one + other) / 2, (one - other) / 2
        channels = {c: picture[..., k] for k, c in enumerate("RGB")} | {
            f"half.{c}": half[..., k] for k, c in enumerate("RGB")
        }
        true = np.sqrt(np.square(picture - 1).mean()) / picture.mean()
        stated = noise_limits(channels)[0]
        above += stated >= true
        ratios.append(stated / true)
    assert above >= 498  # three standard errors of the difference: one of 740 falls below
    assert max(ratios) < 1.5
    assert pytest.approx(18) == AT_MOST**2


def test_bias_and_noise_add_as_squares() -> None:
    made = plan(0.01, (0.04, 0.4, 0.0, 0.03, 0.12))
    found = claimed(0.029, [0.03, 0.3, 0.1, 0.04, 0.05], made)
    assert found["relative_error"] == 0.029
    assert found["error"] == pytest.approx(0.05)
    assert found["noise_by_brightness"] == [0.3, 0.1, 0.04, 0.05]
    assert found["error_by_brightness"] == pytest.approx([0.5, 0.1, 0.05, 0.13])
    unknown = claimed(0.03, [0.03, *[0.3] * 4], default_plan(Optics()))
    assert math.isnan(unknown["error"])
    assert summary({"0000": found}) == "error at most 5.00% (noise 2.90%), 50.00% in the darkest quarter"
    assert summary({"0000": unknown}) == "noise 3.00% (omitted light was not measured), 30.00% in the darkest quarter"


def test_only_what_is_left_out_counts() -> None:
    made = plan(0.01, (0.04,) * 5)
    assert made.bias == (0.04,) * 5
    assert replace(made, rms={}).bias == (0.01,) * 5  # nothing better is known than the share of all light
    assert made.force(off=["indirect light"]).bias[0] != made.bias[0]
    assert TransportPlan.from_dict(made.to_dict()) == made


@pytest.mark.parametrize(("bias", "noise"), [(0.0, 0.05), (0.03, 0.04), (0.05, 0.05), (math.inf, 0.05)])
def test_samples_make_up_for_what_the_plan_leaves_out_while_they_can(bias: float, noise: float) -> None:
    assert noise_target(0.05, plan(0.01, (bias,) * 5)) == pytest.approx(noise)


def test_too_much_that_is_left_out_is_said_at_once() -> None:
    assert warnings_about(plan(0.019, (0.01,) * 5), 0.05) == []
    assert warnings_about(plan(0.019, (0.04,) * 5), None) == []
    (reaches,) = warnings_about(plan(0.019, (0.04,) * 5), 0.05)
    assert reaches.startswith("what the plan leaves out may be an error of 4.00% by itself: samples reach the target")
    (much,) = warnings_about(plan(0.09), 0.05)
    assert much == (
        "the plan leaves out up to 9.00% of the light, more than the 2.00% allowed, most of it by 'paths beyond "
        "max_depth' (max_depth 64); set.json counts it into the error"
    )
    assert warnings_about(plan(math.inf), None)[0].startswith("the plan leaves out an unknown share of the light")
    assert warnings_about(default_plan(Optics()), 0.01) == []


@pytest.mark.parametrize("most", EFFECTS)
def test_of_all_that_is_left_out_the_largest_is_named(most: str) -> None:
    made = plan(0.09)
    effects = tuple(replace(e, on=False, contribution=0.05 if e.name == most else 0.01) for e in made.effects)
    (said,) = warnings_about(replace(made, effects=effects), None)
    assert f"most of it by {most!r}" in said


@pytest.mark.parametrize("moved", [31.9, 32.1, 100.0])
def test_a_motion_that_needs_more_poses_than_there_may_be_is_said(moved: float) -> None:
    made = plan(0.01)
    blur = Effect(name=MOTION, on=True, forced=False, contribution=moved, bound=0.5, unit="px", reason="")
    moving = replace(made, effects=tuple(blur if e.name == MOTION else e for e in made.effects), subframes=64)
    said = warnings_about(moving, None)
    assert len(said) == (moved > 32)
    if moved == 100:
        assert said[0].startswith("the picture moves 100 px during an exposure, rendered as 64 poses")
        assert "copies 1.6 px apart" in said[0]
    assert warnings_about(moving.force(off=[MOTION]), None) == []


def test_where_light_is_missing_is_told_from_noise() -> None:
    """A quarter of the picture, the brightest, lacks a tenth; noise of the same size adds little."""
    full = np.repeat(np.array([1.0, 2.0, 3.0, 4.0]), 16)[None, None, None, :, None] * np.ones((2, 2, 32, 64, 3))
    lacking = np.where(full == 4.0, 0.4, 0.0)
    exact = pilot.root_mean_squares(lacking, full)
    assert exact == pytest.approx((0.2 / 2.5, 0.0, 0.0, 0.0, 0.1), rel=0.05)
    noise = np.random.default_rng(0).standard_normal((2, 2, 32, 64, 1)) * 0.4
    noisy = pilot.root_mean_squares(lacking + noise, full)
    assert noisy == pytest.approx(exact, abs=0.15)
    assert all(a >= b for a, b in zip(noisy, (0.2 / 2.5, 0.0, 0.0, 0.0, 0.1), strict=True))  # it is a limit


def test_of_several_views_the_worst_dark_quarter_is_told() -> None:
    """Each number of the view that has the largest."""
    one = {
        "error": 0.05,
        "relative_error": 0.03,
        "error_by_brightness": [0.2, 0.01],
        "noise_by_brightness": [0.1, 0.02],
    }
    two = {
        "error": 0.04,
        "relative_error": 0.02,
        "error_by_brightness": [0.5, 0.01],
        "noise_by_brightness": [0.3, 0.02],
    }
    assert summary({"0": one, "1": two}) == "error at most 5.00% (noise 3.00%), 50.00% in the darkest quarter"
    unknown = {"0": one | {"error": None}, "1": two}
    assert summary(unknown) == "noise 3.00% (omitted light was not measured), 30.00% in the darkest quarter"
