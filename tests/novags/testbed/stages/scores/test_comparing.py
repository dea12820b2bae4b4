"""Gains and recovered shares of runs of one capture, view by view."""

from collections.abc import Iterable, Mapping
from typing import Any

import pytest

from novags.testbed.metrics.differences import Estimate, estimate
from novags.testbed.stages.scores.comparing import (
    deltas,
    gains,
    recovered_fractions,
    recovered_shares,
    values_of,
    with_errors,
)


def method(value: float, **others: Any) -> dict[str, Any]:
    scores = {"psnr": value - 1, "aligned_psnr": value, "ssim": 0.5, "aligned_ssim": 0.6, "flip": 0.1, "lpips": None}
    mean = {"enhanced": {**scores, **others}, "lit": {**scores, "tone_aligned_psnr": value / 2}}
    views = {str(k): {kind: {name: score and score + off for name, score in own.items()} for kind, own in mean.items()}
             for k, off in enumerate((-1.5, 0.5, 1.0))}  # fmt: skip
    return {"mean": mean, "views": views}


def itself(names: Iterable[str]) -> dict[str, str]:
    """Every run is its method as it is."""
    return {name: name for name in names}


def values(found: Mapping[str, Estimate]) -> dict[str, float]:
    return {name: estimate.value for name, estimate in found.items()}


def fractions(scores: dict[str, Any]) -> tuple[dict[str, float], str | None]:
    found, why = recovered_fractions(scores, itself(scores))
    return values(found), why


def test_recovered_is_the_share_of_the_way_from_naive_to_oracle() -> None:
    recovered, why = recovered_fractions(
        scores := {"nova": method(22.0), "naive": method(20.0), "oracle": method(30.0)}, itself(scores)
    )
    assert values(recovered) == {"nova": pytest.approx(0.2)}
    assert why is None


def test_a_method_worse_than_naive_recovers_a_negative_share() -> None:
    recovered, _ = recovered_fractions(
        scores := {"nova": method(19.0), "naive": method(20.0), "oracle": method(30.0)}, itself(scores)
    )
    assert recovered["nova"].value == pytest.approx(-0.1)


@pytest.mark.parametrize(
    ("methods", "message"),
    [
        ({"nova": method(22.0), "naive": method(20.0)}, "oracle"),
        ({"nova": method(22.0), "naive": method(20.0), "oracle": method(20.05)}, "no share is made"),
        ({"nova": method(22.0), "naive": method(20.0), "oracle": method(18.0)}, "no share is made"),
    ],
)
def test_without_ends_to_measure_between_there_is_a_reason_instead_of_a_number(methods: dict, message: str) -> None:
    recovered, why = recovered_fractions(methods, itself(methods))
    assert recovered == {}
    assert why is not None
    assert message in why


def test_what_is_recovered_is_known_against_both_references() -> None:
    scores = {name: method(value) for name, value in (("nova", 25.0), ("naive", 20.0), ("oracle", 30.0))}
    shares, why = recovered_shares(scores, itself(scores), {})
    assert {column: values(own) for column, own in shares.items()} == {
        "recovered": {"nova": pytest.approx(0.5)},
        "recovered_lit": {"nova": pytest.approx(0.5)},
    }
    assert why == {}
    _, why = recovered_shares({"nova": scores["nova"]}, {"nova": "nova"}, {})
    assert set(why) == {"recovered", "recovered_lit"}


def test_a_variant_of_a_bound_is_measured_between_the_bounds() -> None:
    scores = {"naive": method(20.0), "naive-l1": method(24.0), "oracle": method(30.0)}
    recovered, _ = recovered_fractions(scores, {**itself(scores), "naive-l1": "naive"})
    assert values(recovered) == {"naive-l1": pytest.approx(0.4)}


def test_scores_of_an_earlier_version_have_no_tone_aligned_share_and_say_so() -> None:
    scores = {name: method(value) for name, value in (("nova", 25.0), ("naive", 20.0), ("oracle", 30.0))}
    for found in scores.values():
        for of in (found["mean"], *found["views"].values()):
            del of["lit"]["tone_aligned_psnr"]
    recovered, why = recovered_fractions(scores, itself(scores), "lit", "tone_aligned_psnr")
    assert recovered == {}
    assert "score them again" in (why or "")


def test_of_several_runs_of_a_bound_none_recovers_anything_and_their_mean_is_the_end() -> None:
    scores = {"a/naive": method(20.0), "b/naive": method(22.0), "mine": method(26.0), "a/oracle": method(30.0),
              "b/oracle": method(32.0)}  # fmt: skip
    methods = {name: name.rpartition("/")[2] for name in scores}
    found, why = recovered_fractions(scores, methods)
    assert why is None
    assert values(found) == {"mine": pytest.approx((26 - 21) / (31 - 21))}
    for name in ("a/naive", "b/naive", "a/oracle", "b/oracle"):
        lacking = method(20.0, aligned_psnr=None)
        found, why = recovered_fractions(scores | {name: lacking}, methods)
        assert found == {}
        assert f"{name} have no aligned_psnr against enhanced" in str(why)


@pytest.mark.parametrize(("ceiling", "apart"), [(20.25, 0.15), (20.7, 0.09), (22.0, 0.8)])
def test_there_is_no_share_of_a_span_that_views_or_rates_may_make(ceiling: float, apart: float) -> None:
    """The first two: the demo at 64 px after 100 iterations, whose truth is noisy and is not."""
    scores = {"nova": method(22.0), "naive": method(20.0), "oracle": method(ceiling)}
    for k, off in enumerate((apart * 3**0.5, -apart * 3**0.5, 0.0)):
        scores["oracle"]["views"][str(k)]["enhanced"]["aligned_psnr"] += off
    recovered, why = fractions(scores)
    assert recovered == {}
    assert f"oracle is {ceiling - 20:+.2f} ± {apart:.2f} dB (this scene, 3 views) from naive" in (why or "")


def test_gains_over_the_floor_are_paired_by_view_and_carry_their_error() -> None:
    scores = {"naive": method(20.0), "nova": method(22.0)}
    for k, off in enumerate((0.3, -0.3, 0.0)):
        scores["nova"]["views"][str(k)]["lit"]["tone_aligned_psnr"] += off
    found, base = deltas(scores, itself(scores), "lit", "tone_aligned_psnr", {})
    assert base == "naive"
    assert with_errors(found) == {"nova": pytest.approx(1.0), "nova_error": pytest.approx(0.3 / 3**0.5)}
    assert found["nova"].where == "this scene, 3 views"


def test_a_run_of_which_only_means_are_known_has_values_without_an_error() -> None:
    scores = {name: {"mean": method(value)["mean"]} for name, value in (("naive", 20.0), ("nova", 22.0))}
    assert values_of(scores["nova"], "enhanced", "aligned_psnr", "s", "1") == {("s", "1", ""): 22.0}
    assert values_of(scores["nova"], "enhanced", "lpips") == {}
    found, _ = deltas(scores, itself(scores), "enhanced", "aligned_psnr", {})
    assert (found["nova"].value, found["nova"].error) == (2.0, None)
    assert with_errors(found) == {"nova": 2.0, "nova_error": None}


def test_a_run_of_another_enhancement_has_another_noise_free_reference_and_no_share_of_it() -> None:
    scores = {name: method(value) for name, value in (("naive", 20.0), ("nova", 25.0), ("dim", 34.0), ("oracle", 30.0))}
    own = {"naive": "guided", "nova": "guided", "oracle": "guided", "dim": "darker"}
    shares, _ = recovered_shares(scores, itself(scores), own)
    assert values(shares["recovered"]) == {"nova": pytest.approx(0.5)}
    assert values(shares["recovered_lit"]) == {"nova": pytest.approx(0.5), "dim": pytest.approx(1.4)}
    assert deltas(scores, itself(scores), "enhanced", "aligned_psnr", own)[0].keys() == {"nova", "oracle"}
    assert deltas(scores, itself(scores), "lit", "tone_aligned_psnr", own)[0].keys() == {"nova", "oracle", "dim"}
    shares, why = recovered_shares(scores, itself(scores), own | {"oracle": "darker"})
    assert (shares["recovered"], len(shares["recovered_lit"])) == ({}, 2)
    assert "enhanced by different settings" in why["recovered"]


def test_no_run_is_above_the_mean_of_floors_that_have_different_noise_free_references() -> None:
    scores = {name: method(value) for name, value in (("a/naive", 20.0), ("b/naive", 22.0), ("x", 25.0), ("y", 26.0))}
    methods = {"a/naive": "naive", "b/naive": "naive", "x": "nova", "y": "nova"}
    own = {"a/naive": "guided", "b/naive": "darker", "x": "guided", "y": "darker"}
    assert deltas(scores, methods, "enhanced", "aligned_psnr", own) == ({}, "the mean of 2 runs of naive")
    found, _ = deltas(scores, methods, "enhanced", "aligned_psnr", dict.fromkeys(own, "guided"))
    assert values(found) == {"a/naive": -1.0, "b/naive": 1.0, "x": 4.0, "y": 5.0}


@pytest.mark.parametrize(
    ("apart", "known"),
    [((3.6, 4.4), None), ((2.4, 4.2, 1.9), None), ((4.0, 4.1, 3.9), True), ((0.5, 0.51, 0.49), False),
     ((0.5, 1.6), None), ((0.0, 1.8), None), ((0.54, 0.7, 0.86), False), ((0.5, 0.7, 0.9), None),
     ((3.0,), True), ((0.5,), False)],
)  # fmt: skip
def test_a_gain_that_few_views_cannot_tell_is_neither_there_nor_not(
    apart: tuple[float, ...], known: bool | None
) -> None:
    assert gains(estimate({("", "", str(k)): x for k, x in enumerate(apart)})) is known
