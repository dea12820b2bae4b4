"""Mean and variance of charge that reaches across pixels, where both are known in numbers."""

import numpy as np
import pytest

from sensor_model import effects
from sensor_model.frame.interpixel import bloomed, coupled_variance, positive_part

FULL = 2000.0


def test_an_excess_goes_half_up_and_half_down_with_a_quarter_of_its_variance() -> None:
    """300 e- of 2300, six standard deviations: the pixel is always over full."""
    mu = np.full((7, 2, 1), 50.0)
    mu[2] = 2300.0
    held, spread = bloomed(mu, mu, FULL)
    np.testing.assert_allclose(held[:, 0, 0], [50, 200, FULL, 200, 50, 50, 50], rtol=1e-6)
    np.testing.assert_allclose(spread[:, 0, 0], [50, 625, 0, 625, 50, 50, 50], rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_without_noise_the_means_are_those_of_the_effect(seed: int) -> None:
    mu = np.random.default_rng(seed).uniform(0, 3000, (9, 4, 1))
    held, spread = bloomed(mu, np.zeros_like(mu), FULL)
    np.testing.assert_allclose(held, effects.blooming(mu, FULL), rtol=1e-9)
    np.testing.assert_allclose(spread, 0, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_no_variance_falls_below_zero(seed: int) -> None:
    """Pixels about full, whose excess scatters less once charge has arrived than before."""
    rng = np.random.default_rng(seed)
    mu, variance = rng.uniform(1500, 2600, (9, 4, 1)), rng.uniform(0, 9e4, (9, 4, 1))
    held, spread = bloomed(mu, variance, FULL)
    assert spread.min() >= 0
    assert np.isfinite(held).all()
    assert held.max() <= FULL


def test_coupling_adds_variances_with_the_squares_of_its_shares() -> None:
    rng = np.random.default_rng(0)
    variance = rng.uniform(1, 9, (4, 5, 1))
    wanted = np.zeros_like(variance)
    for place in np.ndindex(variance.shape):
        one = np.zeros_like(variance)
        one[place] = 1
        wanted += effects.crosstalk(one, 0.05) ** 2 * variance[place]
    np.testing.assert_allclose(coupled_variance(variance, 0.05), wanted, rtol=1e-9)


def test_the_positive_part_of_a_normal_number_is_that_of_samples() -> None:
    for mean in (-1.0, 0.0, 2.0):
        samples = np.maximum(np.random.default_rng(0).normal(mean, 1.5, 400_000), 0)
        first, second = positive_part(np.array([mean]), np.array([1.5**2]))
        assert float(first[0]) == pytest.approx(samples.mean(), abs=0.01)
        assert float(second[0]) == pytest.approx(samples.var(), rel=0.02)
