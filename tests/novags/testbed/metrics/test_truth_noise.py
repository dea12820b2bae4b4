"""The noise of a rendered truth is taken out of squared errors, and the standard error says what is left of it."""

from collections.abc import Callable
from functools import cache
from math import inf

import numpy as np
import pytest

from novags.testbed.metrics.images import PSNR_CEILING, gaussian_blur, image_scores, mean_scores
from novags.testbed.metrics.linear import linear_scores
from novags.testbed.metrics.truth import BIAS, ERROR, VARIANCE, leverage, squared_error, variance_of
from sensor_model.isp import linear_to_srgb

Curve = Callable[[np.ndarray], np.ndarray]
TIMES = 24
SIDE = 48


def light() -> np.ndarray:
    return gaussian_blur(np.random.default_rng(5).gamma(1.0, 0.2, (SIDE, SIDE, 3)).astype(np.float32), 1.5)


def shown(radiance: np.ndarray) -> np.ndarray:
    return linear_to_srgb(np.clip(radiance, 0.0, 1.0)).astype(np.float32)


def as_it_is(radiance: np.ndarray) -> np.ndarray:
    return radiance.astype(np.float32)


def picture(curve: Curve = shown) -> np.ndarray:
    """A reconstruction at 28 dB, noisy and a little blurred."""
    noise = np.random.default_rng(9).normal(0, 0.1, (SIDE, SIDE, 3))
    return gaussian_blur((curve(light()) + noise).astype(np.float32), 0.8)


def renders(seed: int, curve: Curve = shown) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A noisy truth and its halves: the channels share their noise, which has heavy tails and grows with light."""
    rng = np.random.default_rng(seed)
    tails = rng.gamma(0.5, 2.0, (2, SIDE, SIDE, 1))  # of mean 1
    first, second = light() * (1 + 0.1 * (tails - 1))
    return curve((first + second) / 2), curve(first), curve(second)


@cache
def by_truth(curve: Curve) -> list[dict[str, float | None]]:
    found = []
    for seed in range(TIMES):
        truth, *halves = renders(seed, curve)
        found.append(image_scores(picture(curve), truth, halves=(halves[0], halves[1])))
    return found


def scored(name: str, curve: Curve) -> tuple[float, np.ndarray, np.ndarray, float]:
    """The score against one noisy truth as it is; against each, corrected, and its standard error; the right score."""
    right, plain = (image_scores(picture(curve), truth)[name] for truth in (curve(light()), renders(0, curve)[0]))
    found = np.array([[scores[name], scores[name + ERROR]] for scores in by_truth(curve)], float)
    return plain or 0.0, found[:, 0], found[:, 1], right or 0.0


@pytest.mark.parametrize("name", ["psnr", "aligned_psnr", "tone_aligned_psnr"])
def test_without_a_curve_corrected_scores_hit_the_known_answer_on_average(name: str) -> None:
    plain, found, _, right = scored(name, as_it_is)
    assert plain < right - 0.3  # dB; without the correction the noise counts as error
    assert abs((found - right).mean()) < 5 * found.std() / np.sqrt(TIMES) + 0.02


@pytest.mark.parametrize("name", ["psnr", "aligned_psnr", "tone_aligned_psnr"])
def test_through_the_curve_of_srgb_corrected_scores_lie_within_their_errors(name: str) -> None:
    plain, found, errors, right = scored(name, shown)
    assert np.mean(np.abs(found - right) < 2 * errors) >= 0.95
    assert abs((found - right).mean()) < 0.1 * (right - plain)  # the bend of the curve is left
    assert errors.mean() < 3 * found.std()  # errors are not so large that they say nothing


def test_a_fit_takes_along_the_part_of_the_noise_that_its_leverage_says() -> None:
    """A picture that knows nothing, fitted to noise: each fit keeps as much of it as it has freedom."""
    noise = np.random.default_rng(0).normal(0, 1, (SIDE, SIDE, 1))
    x = np.random.default_rng(1).uniform(size=(SIDE, SIDE, 1)).astype(np.float32)
    assert leverage(x, "none") == 0.0
    assert np.sum(leverage(x, "affine")) == pytest.approx(2)
    steps = np.round(x * 7)
    assert np.sum(leverage(steps, "tone")) == pytest.approx(8)
    assert np.sum(leverage(np.ones_like(x), "affine")) == pytest.approx(1)
    kept = squared_error(np.zeros_like(noise), noise, np.ones_like(noise), leverage(steps, "tone"))
    assert kept.value == pytest.approx(float(np.mean(noise**2)) - 1 + 8 / noise.size)


def test_the_bias_of_a_score_that_is_not_corrected_is_measured() -> None:
    right = image_scores(picture(), shown(light()))
    for name in ("ssim", "delta_e"):
        moved, measured = [], []
        for seed in range(8):
            truth, *halves = renders(seed)
            scores = image_scores(picture(), truth, halves=(halves[0], halves[1]))
            moved.append((scores[name] or 0) - (right[name] or 0))
            measured.append(scores[name + BIAS])
        assert np.mean(np.array(measured, float)) == pytest.approx(
            np.mean(moved), rel=0.5
        )  # to first order: the sign and the size


def test_a_picture_nearer_than_the_noise_has_no_psnr_and_an_infinite_error() -> None:
    truth, *halves = renders(3)
    scores = image_scores(truth, truth, halves=(halves[0], halves[1]))
    assert scores["psnr"] is None
    assert scores["psnr" + ERROR] == inf
    assert scores[VARIANCE] == pytest.approx(variance_of(*halves).mean())
    other = {**scores, "psnr": 30.0, "psnr" + ERROR: 0.1}
    mean = mean_scores([scores, other, other])
    assert mean["psnr"] == 30.0
    assert mean["psnr" + ERROR] == pytest.approx(0.1 / np.sqrt(2))
    assert mean_scores([scores])["psnr" + ERROR] == inf


def test_a_truth_without_noise_and_one_of_unknown_noise_count_as_they_are() -> None:
    truth = shown(light())
    assert image_scores(truth, truth, halves=(truth, truth))["psnr"] == PSNR_CEILING
    assert "psnr" + ERROR not in image_scores(truth, truth)
    same, plain = image_scores(picture(), truth, halves=(truth, truth)), image_scores(picture(), truth)
    assert {name: same[name] for name in plain} == pytest.approx(plain)


def test_linear_light_loses_its_noise_too() -> None:
    rng, true = np.random.default_rng(2), light() / 4
    seen = gaussian_blur(true, 0.6)
    right = linear_scores(seen, true, 1.0)["linear_psnr"]
    first, second = (true * (1 + 0.1 * rng.normal(size=(SIDE, SIDE, 1))).astype(np.float32) for _ in range(2))
    found = linear_scores(seen, (first + second) / 2, 1.0, (first, second))
    assert found["linear_psnr"] == pytest.approx(right, abs=3 * (found["linear_psnr" + ERROR] or 0))
    assert (linear_scores(seen, (first + second) / 2, 1.0)["linear_psnr"] or 0) < (right or 0) - 0.3
    assert linear_scores(seen, np.zeros_like(true), 1.0) == {"linear_psnr": None}
