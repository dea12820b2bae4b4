"""Claims about merging scores and recovered fractions."""

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.methods.problem import encode
from novags.testbed.folders.exposures import Exposures
from novags.testbed.stages.scores import scoring
from novags.testbed.stages.scores.scoring import recovered_fractions, recovered_shares


def method(value: float, **others: Any) -> dict[str, Any]:
    scores = {"psnr": value - 1, "aligned_psnr": value, "ssim": 0.5, "aligned_ssim": 0.6, "flip": 0.1, "lpips": None}
    return {"mean": {"enhanced": {**scores, **others}, "lit": {**scores, "tone_aligned_psnr": value / 2}}}


def itself(names: Iterable[str]) -> dict[str, str]:
    """Every run is its method as it is."""
    return {name: name for name in names}


def fractions(scores: dict[str, Any]) -> tuple[dict[str, float], str | None]:
    return recovered_fractions(scores, itself(scores))


def test_recovered_is_the_share_of_the_way_from_naive_to_oracle() -> None:
    recovered, why = recovered_fractions(
        scores := {"nova": method(22.0), "naive": method(20.0), "oracle": method(30.0)}, itself(scores)
    )
    assert recovered == {"nova": pytest.approx(0.2)}
    assert why is None


def test_a_method_worse_than_naive_recovers_a_negative_share() -> None:
    recovered, _ = recovered_fractions(
        scores := {"nova": method(19.0), "naive": method(20.0), "oracle": method(30.0)}, itself(scores)
    )
    assert recovered["nova"] == pytest.approx(-0.1)


@pytest.mark.parametrize(
    ("methods", "message"),
    [
        ({"nova": method(22.0), "naive": method(20.0)}, "oracle"),
        ({"nova": method(22.0), "naive": method(20.0), "oracle": method(20.05)}, "too little"),
        ({"nova": method(22.0), "naive": method(20.0), "oracle": method(18.0)}, "too little"),
    ],
)
def test_without_ends_to_measure_between_there_is_a_reason_instead_of_a_number(methods: dict, message: str) -> None:
    recovered, why = recovered_fractions(methods, itself(methods))
    assert recovered == {}
    assert why is not None
    assert message in why


def test_what_is_recovered_is_known_against_both_references() -> None:
    scores = {name: method(value) for name, value in (("nova", 25.0), ("naive", 20.0), ("oracle", 30.0))}
    shares, why = recovered_shares(scores, itself(scores))
    assert shares == {"recovered": {"nova": pytest.approx(0.5)}, "recovered_lit": {"nova": pytest.approx(0.5)}}
    assert why == {}
    _, why = recovered_shares({"nova": scores["nova"]}, {"nova": "nova"})
    assert set(why) == {"recovered", "recovered_lit"}


def test_a_variant_of_a_bound_is_measured_between_the_bounds() -> None:
    scores = {"naive": method(20.0), "naive-l1": method(24.0), "oracle": method(30.0)}
    recovered, _ = recovered_fractions(scores, {**itself(scores), "naive-l1": "naive"})
    assert recovered == {"naive-l1": pytest.approx(0.4)}


def test_scores_of_an_earlier_version_have_no_tone_aligned_share_and_say_so() -> None:
    scores = {name: method(value) for name, value in (("nova", 25.0), ("naive", 20.0), ("oracle", 30.0))}
    for found in scores.values():
        del found["mean"]["lit"]["tone_aligned_psnr"]
    recovered, why = recovered_fractions(scores, itself(scores), "lit", "tone_aligned_psnr")
    assert recovered == {}
    assert "score them again" in (why or "")


def test_light_without_an_enhancement_is_as_consistent_as_the_truth_that_it_is_at_another_exposure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    light = dict(enumerate(np.random.default_rng(0).uniform(0.01, 0.1, (2, 4, 4, 3))))
    still = SimpleNamespace(displacement=np.zeros((4, 4, 2)), visible=np.ones((4, 4), bool))
    monkeypatch.setattr(scoring, "flow", lambda *given: still)
    monkeypatch.setattr(scoring, "references", lambda run, capture, lit, i: {"linear": light[i]})
    run: Any = SimpleNamespace(space="linear", enhancement=None, shows_training_views=True,
                               rendering=lambda name: light[int(name)] / 7)  # fmt: skip
    capture: Any = SimpleNamespace(names=("0", "1"), cameras=SimpleNamespace(test_indices=(0,)))
    source: Any = SimpleNamespace(views=None)
    found = scoring.view_consistency(run, capture, source, Exposures(dark=7.0, lit=None))
    assert found["excess"] == pytest.approx(0, abs=1e-6)
    assert found["reference"] == pytest.approx(np.abs(encode(light[1]) - encode(light[0])).mean(), rel=1e-5)


def test_depth_is_scored_in_the_scale_of_the_true_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    depth, alpha = np.full((4, 4), 1.5), np.ones((4, 4))
    stand_ins: dict[str, Any] = {
        "references": {"lit": None}, "image_scores": {"psnr": 30.0}, "as_compared": None, "true_depth": 3.0 * alpha,
        "missing_references": {}, "view_consistency": {},
    }  # fmt: skip
    for name, value in stand_ins.items():
        monkeypatch.setattr(scoring, name, lambda *given, value=value: value)
    run: Any = SimpleNamespace(
        space="lit", has_depth=True, depth_scale=2.0, rendering=lambda name: None, depth=lambda name: (depth, alpha)
    )
    capture: Any = SimpleNamespace(names=("0000",), cameras=SimpleNamespace(test_indices=(0,)))
    nothing: Any = None
    found = scoring.score_test_views(run, capture, nothing, None, lambda *given: None)["geometry"]
    assert (found["abs_rel"], found["within_5_percent"]) == (0.0, 1.0)
