"""Every effect on its own: its sampler against its distribution, its moments against the closed form."""

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from sensor_model import Banding, DualGain, effects
from sensor_model.frame.streams import Draws

N = 200_000
U = Draws(seed=11).uniforms((400, 500), 0).ravel()


def assert_moments(sample, mean, variance):
    """Mean and variance within five standard errors of the sample."""
    n, centred = sample.size, sample - sample.mean()
    assert sample.mean() == pytest.approx(mean, abs=5 * np.sqrt(variance / n))
    spread = np.sqrt(((centred**4).mean() - (centred**2).mean() ** 2) / n)
    assert sample.var() == pytest.approx(variance, abs=5 * spread)


def share_below(n, mu):
    """P(N <= n) of a Poisson distribution, summed from n downwards in 40 digits until nothing more is added."""
    with mpmath.workdps(40):
        term = mpmath.exp(n * mpmath.log(mu) - mu - mpmath.loggamma(n + 1))
        total = mpmath.mpf(0)
        while n >= 0 and total + term != total:
            total, term, n = total + term, term * n / mu, n - 1
        return total


@pytest.mark.parametrize("mu", [0.0, 5e-324, 1e-300, 1e-6, 0.3, 2.0, 3.999, 4.0, 17.3, 250.0, 1e4, 3e7])
def test_shot_noise_is_the_poisson_quantile(mu):
    # up to where the distribution function still tells two float64 below 1 apart, and for large means only as far as
    # most of scipy's quantiles are right: each sum below takes a second
    tails = 45 if mu < 1e5 else 16
    u = np.concatenate([U[:2000], 2.0 ** -np.arange(1, tails), 1 - 2.0 ** -np.arange(2, tails)])
    got, scipys = effects.shot_noise(u, np.full(u.shape, mu)), stats.poisson.ppf(u, mu)
    # At mu = 3e7 scipy's quantile is an electron off here and there, elsewhere in each release: the sum decides.
    for i in np.flatnonzero(got != scipys):
        assert share_below(int(got[i]) - 1, mu) < u[i] <= share_below(int(got[i]), mu), (u[i], got[i], scipys[i])


@pytest.mark.parametrize("mu", [0.01, 2.0, 60.0, 5e3])
def test_shot_noise_has_mean_and_variance_mu(mu):
    assert_moments(effects.shot_noise(U, np.full(N, mu)), mu, mu)
    assert_moments(effects.normal_shot_noise(U, np.full(N, mu)), mu, mu)


@pytest.mark.parametrize("lam", [-0.3, -0.09, -1e-5, 0.0, 1e-9, 0.14, 0.5, 1.0])
def test_tukey_quantile_and_its_variance_are_those_of_scipy(lam):
    np.testing.assert_allclose(
        effects.tukey_quantile(U[:1000], lam), stats.tukeylambda.ppf(U[:1000], lam), rtol=1e-6, atol=1e-9
    )
    assert effects.tukey_sd(lam) == pytest.approx(np.sqrt(stats.tukeylambda.var(lam)), rel=1e-7)
    if lam > -0.25:
        kurtosis = stats.tukeylambda.stats(lam, moments="k")
        assert effects.excess_kurtosis(lam) == pytest.approx(kurtosis, abs=0.02)


@pytest.mark.parametrize("lam", [None, -0.09, 0.0, 0.14])
def test_read_noise_has_the_standard_deviation_it_is_given(lam):
    assert_moments(effects.read_noise(U, 2.5, lam), 0.0, 2.5**2)


def test_tukey_tails_are_as_heavy_as_lambda_says():
    """Rationale: PMN's fits differ from a Gaussian only in the tails, so these are tested on their own."""
    noise = effects.read_noise(U, 1.0, -0.09)
    kurtosis = (noise**4).mean() / (noise**2).mean() ** 2 - 3
    # the estimator of a heavy tail converges slowly: its own spread from independent parts
    parts = noise.reshape(50, -1)
    spread = ((parts**4).mean(1) / (parts**2).mean(1) ** 2).std() / np.sqrt(50)
    assert kurtosis == pytest.approx(effects.excess_kurtosis(-0.09), abs=5 * spread)
    beyond = np.mean(np.abs(noise) > 5)
    share = 2 * stats.tukeylambda.sf(5 * effects.tukey_sd(-0.09), -0.09)
    assert beyond == pytest.approx(share, abs=5 * np.sqrt(share / N))
    assert share > 100 * 2 * stats.norm.sf(5)


@pytest.mark.parametrize("traps", [1, 2, 5])
@pytest.mark.parametrize("factor", [1.0, 1.5, 2.7])
def test_telegraph_noise_raises_the_standard_deviation_by_its_factor(factor, traps):
    sample = effects.telegraph(U, effects.telegraph_level(1.4, factor, traps), traps)
    assert_moments(sample, 0.0, (factor**2 - 1) * 1.4**2)
    assert len(np.unique(sample)) == (1 if factor == 1 else 2 * traps + 1)


def test_larger_random_numbers_give_larger_values():
    """Rationale: the distributions are symmetric, so a wrong sign would pass every test of moments."""
    np.testing.assert_array_equal(effects.telegraph(np.array([0.2, 0.5, 0.8]), 2.0), [-2, 0, 2])
    np.testing.assert_allclose(effects.pixel_response(np.array([-1.0, 0.0, 2.0]), 0.02), [0.98, 1, 1.04])
    banding = Banding(amplitude=3.0, period=12.0)
    rows = np.array([0, 1, 3, 6, 9])
    np.testing.assert_allclose(effects.bands(0.0, rows, banding), [0, 1.5, 3, 0, -3], atol=1e-12)
    np.testing.assert_allclose(effects.bands(0.25, rows, banding)[:3], [3, 3 * np.cos(np.pi / 6), 0], atol=1e-12)


@pytest.mark.parametrize("lam", [-0.2, -0.004, 0.003, 0.05, 0.3])
def test_excess_kurtosis_is_the_integral_of_the_fourth_power(lam):
    """Independent reference: moments of the quantile function u = 1 / (1 + exp(-z)) up to its middle."""
    u = 1 / (1 + np.exp(-np.linspace(-300, 0, 30_001)))
    weight = u * (1 - u)
    weight[-1] /= 2
    weight /= weight.sum()
    x = effects.tukey_quantile(u, lam)
    second, fourth = (weight @ x**power for power in (2, 4))
    assert effects.excess_kurtosis(lam) == pytest.approx(fourth / second**2 - 3, abs=2e-3)


def test_several_traps_are_the_sum_of_single_ones():
    """Independent reference: that many sums of frames with one trap each."""
    one = [effects.telegraph(np.random.default_rng(i).random(N), 1.0) for i in range(3)]
    together = effects.telegraph(U, 1.0, 3)
    for level in range(-3, 4):
        share = np.mean(sum(one) == level)
        assert np.mean(together == level) == pytest.approx(share, abs=5 * np.sqrt(2 * share / N))


def test_a_point_spread_moves_light_where_its_table_says_and_keeps_it():
    psf = ((0.0, 0.1, 0.05), (0.05, 0.6, 0.2), (0.0, 0.0, 0.0))
    light = np.zeros((7, 9, 3), np.float32)
    light[3, 4] = 100
    spread = effects.point_spread(light, psf)
    np.testing.assert_allclose(spread[2:5, 3:6, 1], 100 * np.array(psf), rtol=1e-6)
    assert spread.dtype == np.float32
    even = ((0, 0.05, 0), (0.05, 0.8, 0.05), (0, 0.05, 0))
    light = np.random.default_rng(0).random((5, 6, 1))
    np.testing.assert_allclose(effects.point_spread(light, even), effects.crosstalk(light, 0.05), rtol=1e-12)


def test_bands_have_the_period_and_the_variance_of_a_sine():
    banding = Banding(amplitude=3.0, period=12.5)
    rows = np.arange(25)
    sample = np.stack([effects.bands(u, rows, banding) for u in U[:20000]])
    assert abs(np.fft.rfft(sample[0])).argmax() == 2  # two periods in 25 rows
    assert_moments(sample[:, 3], 0.0, 4.5)


def test_pixel_response_is_normal_around_one_and_never_negative():
    normal = effects.standard_normal(U)
    assert_moments(effects.pixel_response(normal, 0.02), 1.0, 0.02**2)
    assert effects.pixel_response(10 * normal, 0.2).min() == 0


def test_vignetting_follows_cos4_and_tables_and_crops():
    map_ = effects.relative_illumination((101, 201), corner_angle=35.0)
    assert map_[50, 100] == 1
    angle = np.arctan(np.hypot(50, 100) / np.hypot(50.5, 100.5) * np.tan(np.radians(35)))
    assert map_[0, 0] == pytest.approx(np.cos(angle) ** 4)
    crop = effects.relative_illumination((20, 30), origin=(7, 11), sensor_shape=(101, 201), corner_angle=35.0)
    np.testing.assert_allclose(crop, map_[7:27, 11:41])
    table = effects.relative_illumination((101, 201), falloff=(1.0, 0.75, 0.5))
    assert table[50, 100] == 1
    assert table[0, 0] == pytest.approx(0.5, abs=0.01)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.integers(1, 7), st.integers(1, 7), st.floats(0, 0.2), st.integers(0, 100))
def test_crosstalk_keeps_all_light_and_blurs_a_point_over_five_pixels(h, w, share, seed):
    light = np.random.default_rng(seed).random((h, w, 3)) * 100
    assert effects.crosstalk(light, share).sum() == pytest.approx(light.sum())
    point = np.zeros((5, 5, 1))
    point[2, 2] = 1
    expected = share * np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) + np.diag([0, 1 - 4 * share, 0])
    np.testing.assert_allclose(effects.crosstalk(point, share)[1:4, 1:4, 0], expected, atol=1e-15)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(1, 12), st.integers(0, 1000))
def test_blooming_fills_columns_and_loses_charge_only_over_the_edge(h, seed):
    charge = np.random.default_rng(seed).exponential(60, (h, 4))
    held = effects.blooming(charge, 100.0)
    assert held.max() <= 100
    assert (held >= np.minimum(charge, 100) - 1e-9).all()
    assert (held.sum(0) <= charge.sum(0) + 1e-9).all()


def test_blooming_spills_half_up_and_half_down_and_conserves_charge():
    charge = np.zeros((9, 2))
    charge[4, 0] = 300
    held = effects.blooming(charge, 100.0)
    np.testing.assert_allclose(held[:, 0], [0, 0, 0, 100, 100, 100, 0, 0, 0])
    np.testing.assert_allclose(held[:, 1], 0)
    for row in (1, 7):  # the first and the last row take charge too
        near_edge = effects.blooming(np.where(np.arange(9)[:, None] == row, 300.0, 0.0), 100.0)
        np.testing.assert_allclose(near_edge[:, 0], np.where(abs(np.arange(9) - row) < 2, 100.0, 0.0))


def test_full_well_and_nonlinearity_bend_the_response_as_stated():
    charge = np.array([0.0, 500.0, 1000.0, 2000.0])
    np.testing.assert_allclose(effects.full_well(charge, 1000.0), [0, 500, 1000, 1000])
    # a loss of 4 % at full well 1000 e-, 2 % at half of it
    np.testing.assert_allclose(effects.nonlinear(charge[:3], 0.04 / 1000), [0, 490, 960])


def test_dual_gain_switches_noise_and_code_width_at_its_threshold():
    sigma, width = effects.select_gain(
        np.array([799.0, 800.0, 801.0]), 2.0, DualGain(threshold=800, sigma_d=9, ratio=8)
    )
    np.testing.assert_array_equal(sigma, [2, 2, 9])
    np.testing.assert_array_equal(width, [1, 1, 8])
    assert effects.select_gain(np.zeros(3), 2.0, None) == (2.0, 1.0)


def test_codes_are_rounded_half_to_even_clipped_and_only_then_cast():
    signal = np.array([-1.0, -0.2, 0.5, 1.5, 2.5, 4095.4, 65536.0, 70000.0, 1e30])
    np.testing.assert_array_equal(effects.digitise(signal, 4095), [0, 0, 0, 2, 2, 4095, 4095, 4095, 4095])
    np.testing.assert_array_equal(effects.digitise(np.array([13.0, 65535.4]), 65535, 8.0), [16, 65535])
