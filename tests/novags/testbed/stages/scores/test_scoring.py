"""Claims about merging scores and recovered fractions."""

from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.methods.problem import encode
from novags.testbed.folders.exposures import Exposures
from novags.testbed.metrics.images import psnr
from novags.testbed.stages.scores import scoring
from novags.testbed.stages.scores.scoring import gaussian_blur, recovered_fractions, recovered_shares
from simscenes.sets.pictures.png import write_png


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
        "missing_references": {}, "view_consistency": {}, "reference_halves": {},
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


@pytest.mark.parametrize("shown", [(0, 2, 5), (0, 5), (2, 5)])
def test_every_held_out_view_counts_in_the_consistency_with_the_view_after_it(
    shown: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[tuple[int, int]]()
    monkeypatch.setattr(scoring, "flow", lambda views, i, j: asked.append((i, j)) or SimpleNamespace(
        displacement=np.zeros((4, 4, 2)), visible=np.ones((4, 4), bool)))  # fmt: skip
    reference = {k: np.full((4, 4, 3), 0.1 * k) for k in range(6)}
    monkeypatch.setattr(scoring, "references", lambda run, capture, lit, i: {"lit": reference[i]})
    monkeypatch.setattr(scoring, "as_compared", lambda rendered, *_: rendered)
    run: Any = SimpleNamespace(space="lit", enhancement=None, shows_training_views=True,
                               rendering=lambda name: reference[int(name)])  # fmt: skip
    capture: Any = SimpleNamespace(names=tuple("012345"), cameras=SimpleNamespace(test_indices=shown))
    scoring.view_consistency(run, capture, SimpleNamespace(views=None), None)  # type: ignore[arg-type]
    assert asked == [(i, i + 1 if i < 5 else 4) for i in shown]


@pytest.mark.parametrize("gain", [0.25, 4.0, None])
def test_light_is_compared_in_code_at_the_exposure_of_the_dark_pictures(
    gain: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = np.random.default_rng(0).uniform(0.01, 0.1, (4, 4, 3))
    monkeypatch.setattr(scoring, "references", lambda *_: {"linear": light})
    run: Any = SimpleNamespace(rendering=lambda name: 2 * light)
    capture: Any = SimpleNamespace(names=("0",))
    exposures = None if gain is None else Exposures(dark=gain, lit=None)
    shown, reference = scoring._in_code(run, capture, SimpleNamespace(), 0, exposures)  # type: ignore[arg-type]
    np.testing.assert_allclose(shown, encode((gain or 1.0) * 2 * light), atol=1e-6)
    np.testing.assert_allclose(reference, encode(light), atol=1e-6)


def test_every_reference_and_every_view_counts_in_the_mean_scores(monkeypatch: pytest.MonkeyPatch) -> None:
    """The light of view k is k / 10; a reference lies a tenth or a fifth beside it."""
    light = {k: np.full((4, 4, 3), 0.1 * k) for k in range(6)}
    known = {"enhanced": 0.1, "linear": 0.05, "lit": 0.2}
    monkeypatch.setattr(scoring, "references", lambda run, capture, lit, i: {
        kind: light[i] + off for kind, off in known.items()})  # fmt: skip
    monkeypatch.setattr(scoring, "as_compared", lambda rendered, *_: rendered)
    monkeypatch.setattr(scoring, "missing_references", lambda *_: {"gone": "why"})
    monkeypatch.setattr(scoring, "exposures_of", lambda *_: Exposures(dark=1.0, lit=None))
    monkeypatch.setattr(scoring, "image_scores", lambda a, b, *_: {"psnr": float((100 * a - b + b * 0).mean())})
    monkeypatch.setattr(scoring, "reference_halves", lambda *_: {})
    run: Any = SimpleNamespace(space="linear", has_depth=False, rendering=lambda name: light[int(name)])
    capture: Any = SimpleNamespace(names=tuple("012345"), cameras=SimpleNamespace(test_indices=(1, 4)))
    nothing: Any = None
    found = scoring.score_test_views(run, capture, nothing, ("psnr",), lambda *_: None)
    assert list(found["views"]) == ["1", "4"]
    assert found["mean"]["gone"] is None
    assert found["mean"]["enhanced"]["psnr"] == pytest.approx((10 - 0.2 + 40 - 0.5) / 2, abs=0.3)
    assert found["mean"]["lit"]["psnr"] != found["mean"]["enhanced"]["psnr"]
    assert found["mean"]["linear"]["linear_psnr"] == pytest.approx(-20 * np.log10(0.05), abs=1e-3)


def test_every_training_picture_counts_beside_its_own_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """View 1 is off by 0.1, view 3 by 0.2; view 2 has no camera."""
    truth = {k: np.random.default_rng(k).uniform(0.3, 0.6, (40, 40, 3)).astype(np.float32) for k in range(4)}
    for k, off in ((1, 0.1), (3, 0.2)):
        write_png(tmp_path / "enhanced" / f"{k}.png", truth[k] + off)
        write_png(tmp_path / "denoised" / f"{k}.png", truth[k] + off / 10)
    monkeypatch.setattr(scoring, "references", lambda run, capture, lit, i: {"enhanced": truth[i]})
    run: Any = SimpleNamespace(enhancement={}, path=tmp_path)
    capture: Any = SimpleNamespace(names=tuple("0123"), cameras=SimpleNamespace(train_indices=(1, 2, 3)),
                                   holds=lambda part: True)  # fmt: skip
    nothing: Any = None
    found = scoring.score_training_images(run, capture, nothing)
    assert found is not None
    assert found["enhanced"]["psnr"] == pytest.approx(-20 * (np.log10(0.1) + np.log10(0.2)) / 2, abs=0.05)
    assert found["denoised"]["psnr"] == pytest.approx(found["enhanced"]["psnr"] + 20, abs=0.5)
    each = [gaussian_blur(truth[k] + off, scoring.BLUR_SIGMA) for k, off in ((1, 0.1), (3, 0.2))]
    mean = np.mean([psnr(image, truth[k]) for image, k in zip(each, (1, 3), strict=True)])
    assert found["blur"]["psnr"] == pytest.approx(mean, abs=0.05)


def test_of_several_runs_of_a_bound_none_recovers_anything_and_their_mean_is_the_end() -> None:
    scores = {"a/naive": method(20.0), "b/naive": method(22.0), "mine": method(26.0), "a/oracle": method(30.0),
              "b/oracle": method(32.0)}  # fmt: skip
    methods = {name: name.rpartition("/")[2] for name in scores}
    found, why = recovered_fractions(scores, methods)
    assert why is None
    assert found == {"mine": pytest.approx((26 - 21) / (31 - 21))}
    scores["b/naive"]["mean"]["enhanced"]["aligned_psnr"] = None
    assert "b/naive have no aligned_psnr against enhanced" in str(recovered_fractions(scores, methods)[1])
