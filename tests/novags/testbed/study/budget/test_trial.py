"""What a small experiment says of a large one."""

import json
from pathlib import Path
from typing import Any

import pytest

from novags.methods.variant import parse_variant
from novags.testbed.study.budget.choice import Option
from novags.testbed.study.budget.known import SHIPPED, open_options
from novags.testbed.study.budget.trial import (
    CAUTION,
    OutOfTime,
    StepClock,
    expected,
    in_small,
    pace_of,
    scaled,
    together,
)
from novags.testbed.study.cells.presets import EXPERIMENTS, Preset, adapted
from novags.testbed.study.curves.curve import read_curves
from novags.testbed.study.knobs.options import turned, values

METHODS = EXPERIMENTS["demo"].methods[:2]  # with a denoiser, and without


def preset(**more: Any) -> Preset:
    return adapted(EXPERIMENTS["demo"], methods=METHODS, n_views=20, spp=96, **more)


def write(path: Path, value: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value))


def test_a_pace_is_taken_after_the_first_steps() -> None:
    stamps = {0: 0.0, 1: 50.0, 2: 60.0, 5: 70.0, 6: 70.5, 8: 71.5, 10: 72.5, 11: 90.0}
    assert pace_of(stamps, 0, 10) == pytest.approx(2.5 / 5)
    assert pace_of({1: 3.0, 2: 5.0}, 0, 2) == 2.0  # too few to leave any out
    assert pace_of({20: 0.0, 21: 1.0, 23: 6.0}, 0, 30) == 2.0  # none of them is among the first
    assert pace_of({7: 1.0}, 0, 10) == 0.0
    assert pace_of({}, 0, 10) == 0.0


def test_a_forecast_scales_views_samples_and_steps_and_nothing_else(tmp_path: Path) -> None:
    """By hand: 4 views of 20, 6 samples of 96, 10 denoiser steps of 128, 60 iterations of 2400."""
    large = preset()
    small = in_small(large)
    assert (small.render.n_views, small.render.spp, values(small)["iterations"]) == (4, 6, 60)
    assert values(small)["points"] == values(large)["points"]
    assert small.render.width == large.render.width
    spent = {"load": 2.0, "plan": 3.0, "radiance": 1.5, "geometry": 0.2, "write": 0.3}
    write(tmp_path / "set" / "set.json", {"seconds": spent})
    write(tmp_path / "capture" / "capture.json", {"stage": {"seconds": 0.4}})
    first, second = METHODS
    both = {"stage": {"seconds": 9.0}, "seconds": {"enhance": 0.5}}
    write(tmp_path / first / "run.json", both)
    write(tmp_path / second / "run.json", {"stage": {"seconds": 5.0}, "seconds": {"enhance": 0.1}})
    for name in METHODS:
        write(tmp_path / name / "metrics.json", {"stage": {"seconds": 1.0}})
    denoised = {k: 10 + 0.2 * k for k in range(1, 11)}
    stamps = {
        f"reconstruct {first}": denoised | {k: 12 + 0.05 * (k - 10) for k in range(11, 71)},
        f"reconstruct {second}": {k: 30 + 0.03 * k for k in range(1, 61)},
        f"render {first}": {k: 0.1 * k for k in range(1, 5)},
        f"render {second}": {k: 0.1 * k for k in range(1, 5)},
    }
    tables = expected(large, read_curves(SHIPPED))
    found = scaled(large, small, tmp_path, stamps, 25.0, tables)
    assert found.before["render"] == pytest.approx(1.5 * 16 * (17 + 3 * 8) / (3 + 8))
    assert found.before["fixed"] == pytest.approx(2 + 3 + 0.2 * 5 + 0.3 * 5 + 0.4 * 5)
    assert found.after["denoiser"] == pytest.approx(0.2 * 128)
    assert found.after["fit"] == pytest.approx((0.05 + 0.03) * 2400)
    # outside training, with 16 more views to enhance and to show, and three views to score instead of one
    first_fixed = 9.0 - (0.2 * 10 + 0.05 * 60) + 4 * (0.4 + 0.5) + 3 * 1.0
    second_fixed = 5.0 - 0.03 * 60 + 4 * (0.4 + 0.1) + 3 * 1.0
    rest = 25.0 - 7.0 - 0.4 - 10.0 - 6.0
    assert found.after["fixed"] == pytest.approx(first_fixed + second_fixed + rest)
    whole = sum(found.before.values()) + sum(found.after.values())
    assert sum(found.parts.values()) == pytest.approx(whole)

    assert found.untried == ()
    # A trial that ended in the fit of the second: its denoised one took more than the tables have, part by part
    slow = {part: found.after[part] if part == "denoiser" else 0.05 * 2400 for part in ("denoiser", "fit")}
    tables = {"render": {}, first: {"denoiser": slow["denoiser"] / 4, "fit": slow["fit"] / 2}, second: {"fit": 30.0}}
    (tmp_path / second / "metrics.json").unlink()
    cut = {name: each for name, each in stamps.items() if not name.endswith(second)}
    guessed = scaled(large, small, tmp_path, cut, 18.0, tables)
    pace = sum(slow.values()) / sum(tables[first].values())
    assert guessed.untried == (second,)
    assert guessed.after["fit"] == pytest.approx(0.05 * 2400 + CAUTION * pace * 30.0)
    assert guessed.after["fixed"] == pytest.approx((1 + CAUTION) * first_fixed + 18.0 - 7.0 - 0.4 - 10.0)
    begun = {**cut, f"reconstruct {second}": {k: 30 + 0.03 * k for k in range(1, 41)}}
    assert scaled(large, small, tmp_path, begun, 18.0, tables).after["fit"] == pytest.approx((0.05 + 0.03) * 2400)
    (tmp_path / first / "metrics.json").unlink()  # both are trained in part, and none is scored
    assert scaled(large, small, tmp_path, cut, 18.0, tables).untried == METHODS
    (tmp_path / "capture" / "capture.json").unlink()
    with pytest.raises(OutOfTime):
        scaled(large, small, tmp_path, stamps, 5.0, tables)


def test_tables_foretell_methods_by_steps_pixels_and_gaussians() -> None:
    """By hand: curves of 64 x 64 pixels, 3200 Gaussians and 800 iterations; nobody measured `naive`."""
    own = adapted(preset(width=128, height=64, points=6400), iterations=400)
    work = {"size": "64 x 64", "points": 3200, "views": 16, "samples per pixel": 96, "fit": 800, "denoiser": 100}
    points = [{"knob": "nova.x", "parts": parts, "workload": work} for parts in (
        {"fit": 8.0}, {"denoiser": 10.0}, {"render": 4.0})]  # fmt: skip
    found = expected(own, [*points, {"knob": "nova.y", "parts": {"fit": 1.0}, "workload": {"size": "any"}}])
    first, second = METHODS
    assert found[first] == pytest.approx({"fit": 2 * 8.0 / 800 * 400, "denoiser": 2 * 10.0 / 100 * 128})
    assert found[second] == pytest.approx({"fit": 2 * 8.0 / 800 * 400})
    assert found["render"] == pytest.approx({"render": 4.0 * 2 * (17 + 3 * 8) / 16})
    assert expected(own, []) == {"render": {}, first: {}, second: {}}
    assert together(found)["fit"] == pytest.approx(2 * found[second]["fit"])


def test_a_trial_gives_up_at_its_limit() -> None:
    watch = StepClock(-1.0)
    with pytest.raises(OutOfTime), watch.progress("render") as progress:
        progress(1, 9, "view 0000")
    calm = StepClock(1e9)
    with calm.progress("render") as progress:
        progress(1, 9, "view 0000")
        progress(3, 9, "view 0002")
    assert list(calm.stamps["render"]) == [1, 3]


def test_shares_are_taken_of_the_presets_own_values() -> None:
    own = preset(width=160, height=80)
    assert turned(own, {"iterations": 1.0, "points": 1.0}) == own
    found = turned(own, {"iterations": 0.25, "denoiser_steps": 0.5, "points": 0.1, "spp": 0.5, "size": 0.5})
    assert values(found) == {"iterations": 600, "denoiser_steps": 64, "points": 2000, "spp": 48, "size": 80}
    assert (found.render.width, found.render.height) == (80, 40)
    for name in METHODS:
        assert found.reconstruct(name).config.fit.iterations == 600


def test_what_a_variant_decides_itself_is_neither_the_presets_own_value_nor_open() -> None:
    short = parse_variant("short=naive:fit.iterations=500")
    beside = preset(variants=(short,))
    beside = adapted(beside, methods=("short", *METHODS))
    assert values(beside)["iterations"] == 2400
    found = turned(beside, {"iterations": 0.5})
    assert [found.reconstruct(name).config.fit.iterations for name in found.methods] == [500, 1200, 1200]
    alone = adapted(beside, methods=("short",))
    assert "iterations" not in values(alone)


def test_options_that_the_user_set_or_that_make_no_sense_are_not_open() -> None:
    def some(name: str) -> list[Option]:
        return [Option(name, s, {}, 0.0, 0.0) for s in (0.001, 0.5, 1.0)]

    own = preset()
    options = {name: some(name) for name in ("iterations", "points", "spp", "size")}
    found = open_options(own, options, {"points"})
    assert {name: [o.share for o in settings] for name, settings in found.items()} == {
        "iterations": [0.5, 1.0], "spp": [0.5, 1.0], "size": [0.5, 1.0],
    }  # fmt: skip
    folder = adapted(EXPERIMENTS["demo"], scene=str(Path(__file__).parent), methods=METHODS)
    assert set(open_options(folder, options, ())) == {"iterations", "points"}  # its light is there already
    without = adapted(EXPERIMENTS["demo"], methods=METHODS[1:])
    assert "denoiser_steps" not in values(without)
