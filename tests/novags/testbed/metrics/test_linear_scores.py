"""Claims about scores in linear light: one exposure for the set, its optimum, its peak."""

import numpy as np
import pytest

from novags.testbed.metrics.images import PSNR_CEILING, mean_scores
from novags.testbed.metrics.linear import exposure_gain, linear_psnr, linear_scores


def views(seed: int, n: int = 3) -> list[np.ndarray]:
    return list(np.random.default_rng(seed).uniform(0.01, 0.9, (n, 12, 10, 3)))


def test_the_gain_of_scaled_views_is_found_exactly() -> None:
    truth = views(0)
    assert exposure_gain((v / 37.0, v) for v in truth) == pytest.approx(37.0, rel=1e-12)


def test_the_gain_minimises_the_squared_error_of_the_whole_set() -> None:
    truth = views(1)
    images = [v / 5 + noise for v, noise in zip(truth, np.random.default_rng(2).normal(0, 0.02, (3, 12, 10, 3)))]  # noqa: B905
    images[2] *= 1.4  # a view of its own brightness must not get a gain of its own

    def error(gain: float) -> float:
        return sum(float(((gain * x - y) ** 2).sum()) for x, y in zip(images, truth, strict=True))

    gain = exposure_gain(zip(images, truth, strict=True))
    assert error(gain) < min(error(gain * 1.001), error(gain / 1.001))


def test_a_lamp_beyond_white_does_not_decide_the_exposure() -> None:
    truth = views(3, 1)[0]
    image = truth / 8
    truth[0, 0], image[0, 0] = 500.0, 1.0  # the dark exposure saturates where the reference shows a lamp
    assert exposure_gain([(image, truth)]) == pytest.approx(8.0, rel=1e-12)
    assert exposure_gain([(image, truth)], white=1000.0) > 20


def test_a_saturated_reference_does_not_decide_the_exposure() -> None:
    truth = views(9, 1)[0]
    truth[0, 0] = 10.0  # a lamp, which the noise-free exposure shows as white itself and no brighter
    saturated = np.minimum(truth, 1.0)
    assert exposure_gain([(truth / 8, saturated)]) == pytest.approx(8.0, rel=1e-12)
    assert linear_psnr(truth / 8, saturated, gain=8.0) == PSNR_CEILING


def test_pictures_that_are_white_all_over_are_exposed_to_white() -> None:
    white = np.ones((6, 6, 3))
    assert exposure_gain([(white / 4, white)]) == pytest.approx(4.0, rel=1e-12)


def test_the_unit_of_the_reference_is_its_white() -> None:
    truth = views(4, 1)[0] * 300
    image = truth / 9 + np.random.default_rng(5).normal(0, 0.5, truth.shape)
    gain = exposure_gain([(image, truth)], white=300.0)
    relative = exposure_gain([(image, truth / 300)])
    assert gain == pytest.approx(300 * relative)
    assert linear_psnr(image, truth, gain, white=300.0) == pytest.approx(linear_psnr(image, truth / 300, relative))


def test_the_psnr_of_a_known_error_is_analytic() -> None:
    truth = np.full((6, 6, 3), 0.4)
    assert linear_psnr(truth / 2 + 0.05, truth, gain=2.0) == pytest.approx(20.0, abs=1e-9)  # an error of 0.1 of white
    assert linear_psnr((truth / 2 + 0.05) * 7, truth * 7, gain=2.0, white=7.0) == pytest.approx(20.0, abs=1e-9)


def test_both_pictures_are_clipped_to_black_and_white_after_the_gain() -> None:
    truth = views(6, 1)[0]
    truth[:2] = 40.0
    image = truth / 4
    image[:2] = 0.5  # twice white after the gain
    assert linear_psnr(image, truth, gain=4.0) == PSNR_CEILING
    truth[:2], image[:2] = 0.0, -0.3
    assert linear_psnr(image, truth, gain=4.0) == PSNR_CEILING
    image[:2] = 0.025  # 0.1 of white, over a sixth of the pixels
    assert linear_psnr(image, truth, gain=4.0) == pytest.approx(20.0 + 10 * np.log10(6), abs=1e-9)


def test_what_has_no_exposure_is_refused() -> None:
    truth = views(7)
    with pytest.raises(ValueError, match=r"must be > 0 to match exposures, got 0 over 3 views"):
        exposure_gain((np.zeros_like(v), v) for v in truth)
    with pytest.raises(ValueError, match="over 0 views"):
        exposure_gain([])
    with pytest.raises(ValueError, match="gain must be finite and > 0, got 0"):
        linear_psnr(truth[0], truth[0], gain=0.0)
    with pytest.raises(ValueError, match="white must be finite and > 0, got -1"):
        exposure_gain([(truth[0], truth[0])], white=-1.0)
    with pytest.raises(ValueError, match="of one size"):
        exposure_gain([(truth[0], truth[0][:3])])


def test_light_over_a_black_reference_says_nothing_and_white_pixels_decide_then() -> None:
    image, reference = np.full((4, 4, 3), 0.5), np.zeros((4, 4, 3))
    reference[:2] = 1.0
    assert exposure_gain([(image, reference)]) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="must be > 0 to match exposures"):
        exposure_gain([(image, np.zeros_like(reference))])


@pytest.mark.parametrize("first", [0, 1])
def test_a_black_view_of_a_noisy_truth_has_no_score_and_leaves_the_other_views_their_error(first: int) -> None:
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.2, 0.8, (16, 16, 3)).astype(np.float32)
    noise = rng.normal(0, 0.01, truth.shape).astype(np.float32)
    bright = linear_scores(truth + np.float32(0.1), truth, 1.0, (truth + noise, truth - noise))
    black = linear_scores(truth, np.zeros_like(truth), 1.0, (np.zeros_like(truth), np.zeros_like(truth)))
    assert black.keys() == bright.keys()
    assert black["linear_psnr"] is None
    both = [bright, black] if first == 0 else [black, bright]
    mean = mean_scores(both)  # type: ignore[arg-type]
    assert mean["linear_psnr"] == bright["linear_psnr"]  # type: ignore[typeddict-item]
    assert mean["linear_psnr_error"] == bright["linear_psnr_error"]  # type: ignore[typeddict-item]
