"""What is left of known noise against sums written out, and the bias of clipped noise against its formula."""

import math

import numpy as np
import pytest

from novags.testbed.metrics.images import gaussian_blur
from novags.testbed.metrics.noise import LEVELS, centred_noise, noise_share, squared_bias


def pictures(height: int = 40, width: int = 37) -> tuple[np.ndarray, np.ndarray]:
    """A reference, and the same with noise whose mean and scatter follow its brightness."""
    rng = np.random.default_rng(0)
    reference = gaussian_blur(rng.uniform(0, 1, (height, width, 3)), 1.0)
    return reference + 0.1 * reference**2 + rng.normal(0, 0.05 + 0.1 * reference), reference


def centred_by_hand(noisy: np.ndarray, reference: np.ndarray) -> np.ndarray:
    found = np.empty(noisy.shape)
    for c in range(3):
        places = sorted(np.ndindex(noisy.shape[:2]), key=lambda p, c=c: reference[(*p, c)])
        size, more = divmod(len(places), LEVELS)
        start = 0
        for level in range(LEVELS):
            part = places[start : start + size + (level < more)]
            mean = sum(noisy[(*p, c)] - reference[(*p, c)] for p in part) / len(part)
            for p in part:
                found[(*p, c)] = noisy[(*p, c)] - reference[(*p, c)] - mean
            start += len(part)
    return found


def test_noise_is_centred_at_each_level_of_brightness():
    noisy, reference = pictures()
    np.testing.assert_allclose(centred_noise(noisy, reference), centred_by_hand(noisy, reference), atol=1e-12)


def test_the_share_is_the_regression_on_the_known_noise():
    noisy, reference = pictures()
    image = np.random.default_rng(1).uniform(0, 1, noisy.shape)
    noise = centred_by_hand(noisy, reference)
    expected = ((image - reference) * noise).sum() / (noise * noise).sum()
    assert noise_share(image, noisy, reference) == pytest.approx(expected, abs=1e-12)


def test_the_noisy_picture_holds_all_of_it_the_reference_none_and_a_mixture_its_part():
    noisy, reference = pictures()
    assert noise_share(noisy, noisy, reference) == pytest.approx(1)
    assert noise_share(reference, noisy, reference) == 0
    assert noise_share(0.7 * reference + 0.3 * noisy, noisy, reference) == pytest.approx(0.3)


def test_a_bias_that_follows_brightness_another_exposure_and_blur_hold_nearly_none():
    noisy, reference = pictures(120, 120)
    other = reference + np.random.default_rng(5).normal(0, 0.15, reference.shape)
    # The share scatters by the ratio of the two deviations over the root of 43,200 values.
    for image in (reference + 0.2 * reference**2, other, gaussian_blur(reference, 1.0)):
        assert abs(noise_share(image, noisy, reference)) < 0.03


def test_what_is_added_to_dark_places_alone_is_no_noise():
    rng = np.random.default_rng(6)
    reference = rng.uniform(0, 1, (100, 100, 3))
    biased = reference + 0.3 * np.exp(-reference / 0.1)  # about one mean of all pixels it would be 0.6 of the noise
    assert abs(noise_share(biased, biased + rng.normal(0, 0.05, reference.shape), reference)) < 0.03


def test_without_noise_there_is_no_share():
    _, reference = pictures()
    assert noise_share(reference + 0.1, reference, reference) is None


def test_the_bias_is_the_squared_mean_error_less_the_variance_of_that_mean():
    rng = np.random.default_rng(2)
    exposures, references = rng.uniform(0, 1, (2, 4, 5, 6, 3))
    total = 0.0
    for place in np.ndindex(5, 6, 3):
        errors = [float(e[place] - r[place]) for e, r in zip(exposures, references, strict=True)]
        mean = sum(errors) / 4
        total += mean**2 - sum((e - mean) ** 2 for e in errors) / 3 / 4
    assert squared_bias(list(exposures), list(references)) == pytest.approx(total / (5 * 6 * 3))


def test_six_exposures_tell_the_bias_of_noise_that_was_clipped_at_black():
    rng, sd = np.random.default_rng(3), 0.1
    reference = np.zeros((90, 90, 3))
    exposures = [np.clip(rng.normal(0, sd, reference.shape), 0, None) for _ in range(6)]
    # The mean of the positive half of a Gaussian is sd / sqrt(2 pi).
    assert squared_bias(exposures, [reference] * 6) == pytest.approx(sd**2 / (2 * math.pi), rel=0.02)
    unclipped = [rng.normal(0, sd, reference.shape) for _ in range(6)]
    assert abs(squared_bias(unclipped, [reference] * 6)) < 0.01 * sd**2


def test_one_exposure_tells_no_bias():
    image = np.zeros((4, 4, 3))
    with pytest.raises(ValueError, match="two exposures or more"):
        squared_bias([image], [image])
    with pytest.raises(ValueError, match="2 and 1"):
        squared_bias([image, image], [image])
