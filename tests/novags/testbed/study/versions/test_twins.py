"""Claims about a simulated study beside a real one: order, differences, noise, each equal once and wrong once."""

import itertools
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.stats import spearmanr

from novags.testbed.study.versions import twins
from novags.testbed.study.versions.twins import (
    StudySide,
    TwinVerdict,
    both_sides,
    floor_of,
    noise_ratios,
    rank_correlation,
)
from sensor_model import PRESETS, Exposure, Sensor, develop, expose, from_linear16

METHODS = {"naive": 20.0, "a": 21.0, "b": 22.0, "c": 23.5}


def study(folder: Path, means: dict[str, float], seed: int = 0, electrons: tuple[int, ...] = (20,)) -> Path:
    """A study of two scenes and two seeds whose methods have these PSNRs, with scatter of scenes, seeds and views."""
    rng = np.random.default_rng(seed)
    rows = []
    for number, (scene, method, noise, light) in enumerate(
        itertools.product(("x", "y", "z"), means, (0, 1), electrons)
    ):
        rows.append({"state": "done", "folder": f"run-{number}", "scene": scene, "method": method, "seed": noise,
                     "electrons": light})  # fmt: skip
        views = {f"{v:04d}": {"lit": {"tone_aligned_psnr": means[method] + light / 1e3 + 0.2 * rng.normal()}}
                 for v in (0, 8)}  # fmt: skip
        (folder / f"run-{number}").mkdir(parents=True)
        mean = float(np.mean([own["lit"]["tone_aligned_psnr"] for own in views.values()]))
        scores = {"mean": {"lit": {"tone_aligned_psnr": mean}}, "views": views, "geometry": None}
        (folder / f"run-{number}" / "scores.json").write_text(json.dumps(scores))
    axes = {"scene": ["x", "y", "z"], "method": [*means], "seed": [0, 1], "electrons": list(electrons)}
    (folder / "results.json").write_text(json.dumps({"axes": axes, "rows": rows}))
    return folder


@pytest.fixture(autouse=True)
def _plain_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scores from a plain file: what a run folder is has tests of its own."""

    class Plain:
        def __init__(self, folder: Path) -> None:
            self.folder = folder

        def scores(self) -> Any:
            return json.loads((self.folder / "scores.json").read_text())

    monkeypatch.setattr(twins, "open_run", Plain)


def verdict(twin: Path, real: Path, **more: Any) -> TwinVerdict:
    return TwinVerdict(StudySide.of(twin, {}), StudySide.of(real, {}), **{"against": "naive", "noise": []} | more)


@pytest.mark.parametrize("count", [4, 6, 12])
def test_the_coefficient_is_spearmans_and_the_share_of_orders_that_of_all_orders(count: int) -> None:
    rng = np.random.default_rng(count)
    one = rng.normal(size=count)
    other = one + rng.normal(size=count)
    other[1] = other[0]  # a tie
    found = rank_correlation(one.tolist(), other.tolist())
    theirs = spearmanr(one, other, alternative="greater")
    assert found.value == pytest.approx(theirs.statistic)
    if count == 4:
        orders = [spearmanr(one, order).statistic for order in itertools.permutations(other)]
        assert found.p == pytest.approx(np.mean([value >= found.value - 1e-9 for value in orders]))
    if count > twins.EXACT:
        assert found.p == pytest.approx(theirs.pvalue)


def test_an_order_of_equals_is_none() -> None:
    assert (rank_correlation([1, 1, 1], [1, 2, 3]).value, rank_correlation([1, 1, 1], [1, 2, 3]).p) == (0.0, 1.0)
    assert rank_correlation([1, 2, 3], [6, 5, 4]).value == -1


def test_a_twin_that_is_right_agrees_in_order_and_differences(tmp_path: Path) -> None:
    shifted = {name: value - 4 for name, value in METHODS.items()}  # all darker: no matter
    found = verdict(study(tmp_path / "twin", METHODS), study(tmp_path / "real", shifted, seed=1))
    order = found.order("lit", "tone_aligned_psnr")
    assert order is not None
    assert (order.value, order.p) == (1.0, pytest.approx(1 / 24))
    assert [each.agrees for each in found.differences("lit", "tone_aligned_psnr")] == [True, True, True]
    text = "\n".join(found.lines())
    assert "rank correlation 1.00 of 4 methods (p = 0.042); 3 of 3 differences to naive agree" in text
    assert "differs" not in text


def test_a_twin_that_is_wrong_about_a_method_says_which(tmp_path: Path) -> None:
    real = METHODS | {"c": 18.0}
    found = verdict(study(tmp_path / "twin", METHODS), study(tmp_path / "real", real, seed=1))
    assert found.order("lit", "tone_aligned_psnr").value == pytest.approx(-0.2)  # type: ignore[union-attr]
    agrees = {each.method: each.agrees for each in found.differences("lit", "tone_aligned_psnr")}
    assert agrees == {"a": True, "b": True, "c": False}
    (line,) = [line for line in found.lines() if "(differs)" in line]
    assert line.startswith("  c: +3.")
    rows = found.rows()
    assert [(row["method"], row["agrees"]) for row in rows] == [("a", True), ("b", True), ("c", False)]
    assert rows[2]["twin"] == pytest.approx(3.5, abs=0.3)
    assert rows[2]["real"] == pytest.approx(-2.0, abs=0.3)


@pytest.mark.parametrize("missing", ["x", "y"])
def test_a_run_that_failed_takes_its_scene_from_the_order_of_all_methods(tmp_path: Path, missing: str) -> None:
    """Rationale: the mean of the best method was of hard scenes alone, and it came last."""
    for name in ("twin", "real"):
        study(tmp_path / name, METHODS)
    table = tmp_path / "real" / "results.json"
    results = json.loads(table.read_text())
    for row in results["rows"]:
        scores = tmp_path / "real" / row["folder"] / "scores.json"
        found = json.loads(scores.read_text())
        for own in (found["mean"], *found["views"].values()):
            own["lit"]["tone_aligned_psnr"] += 10.0 * (row["scene"] == missing)
        scores.write_text(json.dumps(found))
        if (row["scene"], row["method"]) == (missing, "c"):
            row["state"] = "failed"
    table.write_text(json.dumps(results))
    sides = both_sides(tmp_path / "twin", tmp_path / "real", {})
    order = TwinVerdict(*sides, "naive", []).order("lit", "tone_aligned_psnr")
    assert order is not None
    assert order.value == 1.0
    for row in results["rows"]:  # no scene has two methods
        row["state"], row["scene"] = "done", row["method"]
    table.write_text(json.dumps(results))
    sides = both_sides(tmp_path / "twin", tmp_path / "real", {})
    verdict = TwinVerdict(*sides, "naive", [])
    assert verdict.order("lit", "tone_aligned_psnr") is None
    assert verdict.lines()[0].startswith("lit.tone_aligned_psnr: no order: the methods have no value in common; ")


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    twin, real = study(tmp_path / "twin", METHODS), study(tmp_path / "real", {"a": 1.0, "b": 2.0, "d": 3.0})
    with pytest.raises(ValueError, match="3 methods or more must be in both studies, got 2"):
        verdict(twin, real).lines()
    with pytest.raises(ValueError, match="--against must be a method of both studies"):
        verdict(twin, twin, against="oracle").lines()
    with pytest.raises(ValueError, match="holds no results.json: it is no folder of a study"):
        StudySide.of(tmp_path, {})
    several = study(tmp_path / "several", METHODS, electrons=(5, 20))
    with pytest.raises(ValueError, match="runs of several electrons .5, 20.* add --where electrons=5"):
        StudySide.of(several, {})
    assert (
        len(StudySide.of(several, {"electrons": "5"}).rows)
        == len(StudySide.of(several, {"electrons": "5"}).scores)
        == 24
    )
    with pytest.raises(ValueError, match="no finished run with electrons=7"):
        StudySide.of(several, {"electrons": "7"})
    with pytest.raises(ValueError, match="--where electron: neither study has such an axis; did you mean 'electrons'"):
        both_sides(twin, twin, {"electron": "20"})


@pytest.mark.parametrize("own", ["twin", "real"])
def test_any_axis_of_either_side_may_choose_its_runs(own: str, tmp_path: Path) -> None:
    """The light is an axis of one side alone, and the scene of both."""
    paths = [study(tmp_path / name, METHODS, electrons=(5, 20) if name == own else (20,)) for name in ("twin", "real")]
    for path in paths:
        if path.name != own:
            table = json.loads((path / "results.json").read_text())
            del table["axes"]["electrons"]
            (path / "results.json").write_text(json.dumps(table))
    sides = both_sides(paths[0], paths[1], {"scene": "y", "electrons": "20"})
    found = [{(row["scene"], row["electrons"]) for row in side.rows} for side in sides]
    assert found == [{("y", 20)}, {("y", 20)}]


def test_every_row_tells_of_its_method_and_its_capture_and_each_capture_counts_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures = {"r0": Path("one"), "r1": Path("two"), "r2": Path("two")}
    monkeypatch.setattr(twins, "open_run", lambda folder: SimpleNamespace(
        capture=lambda: SimpleNamespace(path=captures[folder.name])))  # fmt: skip
    monkeypatch.setattr(twins, "pictures_of", lambda capture: [f"{capture.path} {k}" for k in range(2)])
    rows = [{"method": method, "folder": folder} for method, folder in zip(("a", "b", "c"), captures, strict=True)]
    side = StudySide(tmp_path, rows, ("method",))
    assert side.methods == ["a", "b", "c"]
    assert side.pictures() == ["one 0", "one 1", "two 0", "two 1"]


@pytest.mark.parametrize("deep", [True, False])
def test_the_pictures_of_a_capture_are_all_its_training_views(deep: bool) -> None:
    capture: Any = SimpleNamespace(
        cameras=SimpleNamespace(train_indices=[1, 2, 4]), holds=lambda name: deep and name == "images16",
        srgb8=lambda i: np.full((2, 2, 3), i / 8, np.float32), linear16=lambda i: np.full((2, 2, 3), i, np.float32),
    )  # fmt: skip
    found = twins.pictures_of(capture)
    assert [float(code.mean()) for code, _ in found] == [1 / 8, 2 / 8, 4 / 8]
    assert [None if light is None else float(light.mean()) for _, light in found] == ([1, 2, 4] if deep else [None] * 3)


def test_the_floor_of_the_scale_is_what_others_are_compared_with() -> None:
    assert floor_of(["nova", "naive", "oracle"]) == "naive"
    assert floor_of(["mine", "nova"]) == "mine"


def pictures(sensor: Sensor, seed: int, views: int = 6) -> list[tuple[torch.Tensor, torch.Tensor | None]]:
    """Exposures of a smooth scene, another for each seed."""
    y, x = np.mgrid[:96, :128] / 96
    found: list[tuple[torch.Tensor, torch.Tensor | None]] = []
    for view in range(views):
        waves = [1.2 + np.sin(3 * x + view + seed + c) * np.cos(2 * y - c) for c in range(3)]
        photons = 4.0 * np.stack(waves, -1) / sensor.eta
        frame = develop(expose(photons, sensor, Exposure(time=1 / 30), seed=seed, view=view), sensor)
        found.append((torch.from_numpy(frame.srgb8 / np.float32(255)), torch.from_numpy(from_linear16(frame.linear16))))
    return found


def test_the_noise_of_the_same_camera_is_the_same_and_a_wrong_read_noise_is_seen_where_it_is_dark() -> None:
    """Expectation: 30 % more read noise of s electrons beside n of light: the ratio of sqrt(n + s²)."""
    sensor = replace(PRESETS["a7s2-iso6400-3chip"], sigma_d=3.0, dsnu=0.0, prnu=0.0)
    real = pictures(sensor, 1)
    same = noise_ratios(pictures(sensor, 0), real)
    assert len(same) == 3
    assert not any(ratio.seen for ratio in same)
    assert all(abs(ratio.value - 1) < 0.05 for ratio in same)
    weak = replace(sensor, sigma_d=0.7 * sensor.sigma_d)
    wrong = noise_ratios(pictures(weak, 0), real)
    assert wrong[0].seen
    for ratio in wrong:
        light = ratio.level * (sensor.white_dn - sensor.black_level) / sensor.gain  # electrons
        expected = np.sqrt((light + weak.sigma_d**2) / (light + sensor.sigma_d**2))
        assert abs(ratio.value - expected) < 2 * ratio.error


@pytest.mark.parametrize("order", [1, -1])
def test_the_levels_of_light_are_of_all_real_pictures_together(order: int) -> None:
    """The brighter view has eight times the light of the other."""
    codes = [(code, light) for code, light in pictures(PRESETS["a7s2-iso6400-3chip"], 1, views=1) if light is not None]
    real = [(code / share, light / share) for share in (1, 8) for code, light in codes][::order]
    greens = np.concatenate([light[..., 1].numpy().ravel() for _, light in real])
    found = noise_ratios(real, real)
    assert [ratio.level for ratio in found] == pytest.approx(np.quantile(greens.astype(float), twins.LEVELS))


def test_without_linear_pictures_of_both_the_8_bit_ones_are_compared_and_one_view_says_nothing() -> None:
    sensor = PRESETS["a7s2-iso6400-3chip"]
    real = [(code, None) for code, _ in pictures(sensor, 1)]
    found = noise_ratios(pictures(sensor, 0), real)
    assert not any(ratio.seen for ratio in found)
    assert all(abs(ratio.value - 1) < 0.2 for ratio in found)
    assert noise_ratios(pictures(sensor, 0), real[:1]) == []
