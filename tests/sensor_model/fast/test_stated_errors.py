"""Numbers that comments of the kernels and the planner state about their own errors."""

import numpy as np
import pytest
from scipy import special

from sensor_model import PRESETS, Exposure, Sensor, plan_effects
from sensor_model.fast import blocks
from sensor_model.fast.kernels import MU, C, N, P, U, W, X, exp16, log
from sensor_model.fast.kernels32 import log32
from sensor_model.fast.poisson import SMALL_MEAN, SMALL_SLACK, _count_up, _series

RNG = np.random.default_rng(0)
POSITIVE = np.concatenate([np.exp(RNG.uniform(-80, 80, 5000)), 1 + RNG.uniform(-1e-3, 1e-3, 5000)])


def test_logarithms_and_exponentials_are_as_exact_as_they_say():
    found = np.array([log(x) for x in POSITIVE])
    np.testing.assert_allclose(found, np.log(POSITIVE), rtol=1e-15)
    powers = np.linspace(-4, 4, 5001)
    np.testing.assert_allclose([exp16(x) for x in powers], np.exp(powers), rtol=1e-14)
    narrow = POSITIVE.astype(np.float32)
    exact = np.log(narrow.astype(np.float64))
    found = np.array([log32(x) for x in narrow])
    assert (np.abs(found - exact) / np.maximum(1, np.abs(exact))).max() < 2e-7


def poisson_quantile(w, mu):
    """The real x with P(N < x) = Phi(w), P(N < x) continued between whole x by the incomplete gamma function."""
    low, high = np.full(w.shape, 1e-9), mu + 20 * np.sqrt(mu) + 100
    for _ in range(100):
        x = 0.5 * (low + high)
        lower = special.gammaincc(x, mu) > special.ndtr(w)
        upper = special.gammainc(x, mu) < special.ndtr(-w)  # of the two tails the small one has all its digits
        beyond = np.where(w > 0, upper, lower)
        low, high = np.where(beyond, low, x), np.where(beyond, x, high)
    return low


@pytest.mark.parametrize("mu", [4.0, 4.5, 6.0, 9.0, 16.0, 40.0, 250.0, 3e3, 1e5])
def test_the_poisson_series_errs_by_less_than_the_slack_it_gives(mu):
    w = np.linspace(-5.1, 5.1, 500).astype(np.float32)
    n = w.size
    _, f, _ = blocks.scratch()
    f[MU : MU + n], f[W : W + n], f[P : P + n] = mu, w, special.ndtr(-np.abs(w))
    _series(f, n)
    error = np.abs(mu + f[N : N + n].astype(np.float64) - poisson_quantile(w.astype(np.float64), np.full(n, mu)))
    assert (error <= f[C : C + n]).all()
    assert (f[C : C + n] < 0.05)[np.abs(w) < 2].all()  # double precision everywhere would hide this


def test_small_counts_know_within_their_slack_how_near_they_came_to_another():
    mu, u = RNG.uniform(0, SMALL_MEAN, 500).astype(np.float32), RNG.random(500)
    _, f, _ = blocks.scratch()
    for at, value in ((MU, mu), (U, u), (P, np.exp(-mu)), (C, np.exp(-mu)), (N, 0.0), (X, 1.0)):
        f[at : at + 500] = value
    _count_up(f, 500)
    exact = np.abs(u - special.pdtr(np.arange(40)[:, None], mu.astype(np.float64))).min(0)
    assert np.abs(f[X : X + 500] - exact).max() < 0.5 * SMALL_SLACK


@pytest.mark.parametrize("sigma_d", [0.0, 0.1, 0.3, 0.5, 2.0])
@pytest.mark.parametrize("mu", [0.5, 5.0, 100.0])
def test_the_plan_bounds_the_distance_of_normal_from_poisson_noise(mu, sigma_d):
    """Kolmogorov distance of shot and read noise from a normal of their variance, from the distribution functions."""
    sensor = Sensor(gain=1.0, eta=1.0, mu_e_sat=1e5, black_level=200.0, bits=14, sigma_d=sigma_d, cfa=None)
    k = np.arange(int(mu + 12 * np.sqrt(mu) + 40))
    share = np.exp(special.xlogy(k, mu) - mu - special.gammaln(k + 1))
    away = np.linspace(-6, 6, 4001) * np.hypot(np.sqrt(mu), sigma_d)
    x = np.unique([mu + away, np.rint(mu + away), np.nextafter(np.rint(mu + away), -np.inf)])
    step = x[:, None] >= k if sigma_d == 0 else special.ndtr((x[:, None] - k) / sigma_d)
    distance = np.abs(step @ share - special.ndtr((x - mu) / np.hypot(np.sqrt(mu), sigma_d))).max()
    plan = plan_effects(sensor, Exposure(time=0.05), mu)
    assert distance <= plan["poisson"].contribution


def test_light_counted_as_of_555_nm_is_right_under_daylight_and_a_fifth_too_high_under_tungsten():
    """Independent reference: luminance and photons integrated over the spectra of colour-science."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its optional parts warn when they are not there
        import colour
    from sensor_model import Lens, electrons_from_luminance, photons_from_spectrum

    lens, exposure, eta = Lens(f_number=1.8, pixel_pitch=2.25e-6), Exposure(time=0.01), PRESETS["imx900-hcg"].eta
    shape = colour.SpectralShape(380, 780, 1)
    green = eta * 2.0 ** -((2 * (shape.wavelengths - 535) / 100) ** 2)
    seen = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"].copy().align(shape).values
    for light, ratio in (("D65", 1.0), ("A", 1.22)):
        spectrum = colour.SDS_ILLUMINANTS[light].copy().align(shape).values
        given = electrons_from_luminance(683.0 * float(seen @ spectrum), lens, exposure, eta=eta)
        photons = photons_from_spectrum(spectrum, shape.wavelengths, lens, exposure, qe=green[:, None], eta=eta)
        assert given / (eta * photons[0]) == pytest.approx(ratio, abs=0.01)
