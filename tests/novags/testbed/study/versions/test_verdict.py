"""Claims about the verdict of a comparison: it says what the paired differences show, and no more."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.metrics.differences import shift_seen
from novags.testbed.study.versions.pairs import Fit, FittedCase, Pair
from novags.testbed.study.versions.verdict import ComparisonVerdict

NAMES = {"base": "naive", "changed": "mine"}


def fit(values: np.ndarray, cpu: float | None = 10.0, shown: str = "bits", lit: float = 0.0) -> Fit:
    """A run with these scores of its views."""
    views = {f"{k:04d}": {"enhanced": {"aligned_psnr": float(v)}, "lit": {"tone_aligned_psnr": float(v) + lit}}
             for k, v in enumerate(values)}  # fmt: skip
    mean = {kind: {number: float(np.mean([view[kind][number] for view in views.values()]))}
            for kind, number in (("enhanced", "aligned_psnr"), ("lit", "tone_aligned_psnr"))}  # fmt: skip
    record = {
        "enhancement": {"enhancer": "guided", "config": {}},
        "stage": {"files": {"exr/0000.exr": shown}, "code": ""},
    }
    run: Any = SimpleNamespace(record=record, method="naive", peak_bytes=5_000_000, path=Path("run"))
    return Fit(run, {"mean": mean, "views": views}, cpu)


def verdict(
    gain: float, sd: float = 0.01, scenes: int = 3, seeds: int = 2, views: int = 3, cpu: float | None = 12.0,
    shown: str = "other", lit: float = 0.0,
) -> ComparisonVerdict:  # fmt: skip
    """Of runs whose scores scatter much from scene to scene and view to view, alike on both sides."""
    rng, pairs = np.random.default_rng(0), []
    for scene in range(scenes):
        for seed in range(seeds):
            alike = 20 + 5 * scene + rng.normal(0, 3, views)
            case = FittedCase(Path("capture"), f"scene {scene}", str(seed), seed)
            changed = fit(alike + gain + rng.normal(0, sd, views), cpu, shown, lit)
            pairs.append(Pair(case, "naive", fit(alike), changed))
    return ComparisonVerdict(NAMES, pairs)


def test_a_gain_that_all_share_is_seen_through_the_scatter_of_scenes_and_views() -> None:
    found = verdict(0.2)
    assert found.headline.startswith("changed (mine) is above base (naive) by 0.198")
    assert "(PSNR aligned, noise-free; 3 scenes, 2 fits, 3 views)" in found.headline
    assert "views) and by 0.198" in found.headline  # in the other score
    row = found.whole[0]
    assert abs(row["difference"] - 0.2) < 5 * 0.01 / np.sqrt(18)
    assert 0 < row["error"] < 0.02  # of the differences: the scores themselves scatter by 3 dB
    assert not found.below


def test_a_loss_is_below_whichever_score_shows_it() -> None:
    assert verdict(-0.2).below
    found = verdict(0.2, lit=-0.4)
    assert found.below
    assert " is above base (naive) by 0.19" in found.headline
    assert " and below it by 0.20" in found.headline


def test_what_scatters_more_than_it_gains_is_no_difference_and_says_what_would_be_seen() -> None:
    found = verdict(0.02, sd=0.5)
    assert found.headline.startswith("No difference is seen: ")
    least = float(found.headline.rpartition("is ")[2].split()[0])
    row = found.whole[0]
    # Beyond the interval of 95 %, as far as four of five estimates lie above their truth less that.
    assert least == float(f"{shift_seen(row['freedom']) * row['error']:.2g}")
    assert not found.below


def test_nothing_that_repeats_has_no_error() -> None:
    found = verdict(0.2, scenes=1, seeds=1, views=1)
    assert found.headline.startswith("No error is known, because nothing repeats: +0.2")
    assert "1 scene, 1 fit, 1 view" in found.headline
    assert not found.below
    assert found.ratio is not None
    assert found.ratio.error is None
    assert "1.200 times" in "\n".join(found.lines())


def test_equal_pictures_are_said_to_be_and_one_that_differs_is_enough() -> None:
    found = verdict(0.0, sd=0.0, shown="bits")
    assert found.headline == "changed (mine) shows the same pictures as base (naive), bit for bit."
    assert not found.below
    for k in (0, 2, -1):
        pairs = list(found.pairs)
        pairs[k] = replace(pairs[k], changed=fit(np.array([20.0]), shown="other"))
        assert not ComparisonVerdict(NAMES, pairs).same


@pytest.mark.parametrize("cpu", [5.0, 10.0, 20.0])
def test_the_ratio_of_processor_seconds_is_of_pairs(cpu: float) -> None:
    found = verdict(0.0, cpu=cpu).ratio
    assert found is not None
    assert np.exp(found.value) == pytest.approx(cpu / 10)
    assert found.error == pytest.approx(0, abs=1e-12)
    assert found.scenes == 3


def test_a_fit_in_several_goes_is_left_out_of_the_ratio() -> None:
    found = verdict(0.0, cpu=None)
    assert found.ratio is None
    assert "processor" not in "\n".join(found.lines())
    assert found.record()["cost"]["changed"]["cpu_seconds"] is None


def test_one_scene_speaks_of_this_scene_alone_and_several_of_all() -> None:
    one, two = verdict(0.2, scenes=1), verdict(0.2, scenes=2)
    assert [(row["scene"], row["score"]) for row in one.whole] == [
        ("scene 0", "enhanced.aligned_psnr"), ("scene 0", "lit.tone_aligned_psnr")
    ]  # fmt: skip
    assert {row["scene"] for row in two.whole} == {"all scenes"}
    assert len(two.rows) == 3 * len(two.whole)


def test_two_enhancements_are_not_compared_with_one_reference() -> None:
    found = verdict(0.2)
    for pair in found.pairs:
        pair.changed.run.record["enhancement"] = {"enhancer": "other", "config": {}}
    assert {row["score"] for row in found.rows} == {"lit.tone_aligned_psnr"}


def test_every_pair_counts_for_costs_and_every_scene_is_told_of() -> None:
    pairs = list[Pair]()
    for k, (pair, peak) in enumerate(zip(verdict(0.2).pairs, (3, 1, 6, 2, 5, 4), strict=True)):
        pair.base.run.peak_bytes, pair.changed.run.peak_bytes = peak * 1_000_000, peak * 2_000_000  # type: ignore[misc]
        pairs.append(replace(
            pair, base=replace(pair.base, cpu_seconds=10.0 + k), changed=replace(pair.changed, cpu_seconds=20.0 + 2 * k)
        ))  # fmt: skip
    found = ComparisonVerdict(NAMES, pairs)
    record = found.record()
    assert record["cost"] == {
        "base": {"cpu_seconds": 12.5, "peak_bytes": 6_000_000},
        "changed": {"cpu_seconds": 25.0, "peak_bytes": 12_000_000},
    }
    scenes = [f"scene {k}" for k in range(3)]
    assert [(each["scene"], each["noise"]) for each in record["pairs"]] == [(s, seed) for s in scenes for seed in "01"]
    said = "\n".join(found.lines())
    assert [said.count(f", {scene}\n") for scene in scenes] == [2, 2, 2]  # a line for each score
    assert "6 pairs of fits" in said
    assert "12 (changed) and 6 (base) MB" in said


@pytest.mark.parametrize("places", [("at-5", "at-20"), ("at-20", "at-5")])
def test_captures_of_one_set_that_share_their_noise_all_count_in_any_order(places: tuple[str, str]) -> None:
    """Changed is 3 dB worse at 5 electrons and 1 dB better at 20, and takes twice and four times as long."""
    gains, pairs = {"at-5": (-3.0, 20.0), "at-20": (1.0, 40.0)}, []
    for place in places:
        case, (gain, cpu) = FittedCase(Path("out") / place, "at-5", "0", 0), gains[place]
        pairs.append(Pair(case, "naive", fit(np.arange(3.0)), fit(np.arange(3.0) + gain, cpu, "other")))
    found = ComparisonVerdict(NAMES, pairs)
    assert found.whole[0]["difference"] == pytest.approx(-1.0)
    assert found.whole[0]["error"] == pytest.approx(2.0)
    assert not found.below  # two captures that disagree tell nothing
    assert found.ratio is not None
    assert np.exp(found.ratio.value) == pytest.approx(8**0.5)
