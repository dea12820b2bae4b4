"""The fused kernels give, bit for bit, the frame of the numpy reference, however the work is cut."""

import subprocess
import sys

import numpy as np
import pytest

from sensor_model import Banding, Defects, DualGain, Exposure, Sensor, SensorOptics, expose
from sensor_model.fast import blocks, capture_fused

BASE = {"gain": 1.3, "eta": 0.6, "mu_e_sat": 3000.0, "black_level": 100.0, "bits": 12, "sigma_d": 2.0, "cfa": None}
CHAINS = {
    "plain": {},
    "heavy tails": {"tukey_lambda": -0.07},
    "very heavy tails": {"tukey_lambda": -0.45},
    "light tails": {"tukey_lambda": 0.9},
    "logistic": {"tukey_lambda": 0.0},
    "rows and columns": {"sigma_row": 1.0, "sigma_column": 0.5, "banding": Banding(amplitude=2.0, period=7)},
    "fixed pattern": {"dsnu": 2.0, "prnu": 0.01},
    "defects": {
        "dark_current": 20.0,
        "defects": Defects(hot_fraction=0.01, hot_factor=50, rts_fraction=0.02, rts_factor=3),
    },
    "optics": {"optics": SensorOptics(corner_angle=30, crosstalk=0.02)},
    "dual gain": {"dual_gain": DualGain(threshold=800, sigma_d=20, ratio=6)},
    "dual gain, heavy tails": {"dual_gain": DualGain(threshold=800, sigma_d=20, ratio=6), "tukey_lambda": -0.07},
    "nonlinear": {"nonlinearity": 0.03},
    "blooming": {"blooming": True},
    "coupling": {"coupling": 0.02, "nonlinearity": 0.01},
    "blooming and coupling": {"blooming": True, "coupling": 0.02},
    "point spread": {"optics": SensorOptics(psf=((0.01, 0.05, 0.02), (0.04, 0.8, 0.08), (0.0, 0.0, 0.0)))},
    "several traps": {"defects": Defects(rts_fraction=0.2, rts_factor=4, rts_traps=3)},
    "black bias": {"rgb_bias": (1.0, 2.0, -3.0)},
    "bayer black bias": {"rgb_bias": (1.0, 2.0, -3.0), "cfa": "GBRG"},
    "no read noise": {"sigma_d": 0.0},
}
EXPOSURE = Exposure(time=0.1, origin=(3, 5))


def light(channels, shape=(47, 523)):
    """From nothing to far over full well, in no order."""
    photons = np.exp(np.random.default_rng(1).uniform(-4, 10, (*shape, channels)))
    photons[::7, ::5] = 0
    return photons[..., 0] if channels == 1 else photons


@pytest.mark.parametrize("shot", ["poisson", "normal", "none"])
@pytest.mark.parametrize("chain", list(CHAINS))
def test_kernels_equal_the_numpy_reference(chain, shot):
    sensor = Sensor(**(BASE | CHAINS[chain]))
    photons = light(1 if sensor.cfa else 3)
    fast = expose(photons, sensor, EXPOSURE, seed=7, view=1, shot=shot)
    plain = expose(photons, sensor, EXPOSURE, seed=7, view=1, shot=shot, backend="numpy")
    np.testing.assert_array_equal(fast.dn, plain.dn)
    np.testing.assert_array_equal(fast.saturated, plain.saturated)


@pytest.mark.parametrize("chain", ["plain", "rows and columns", "blooming", "coupling", "defects"])
def test_frames_do_not_depend_on_threads_or_chunks(chain, monkeypatch):
    sensor = Sensor(**(BASE | CHAINS[chain]))
    photons = light(3)
    whole = expose(photons, sensor, EXPOSURE, seed=7, view=1, threads=1).dn
    for pixels in (1, 4000, 1 << 16):  # 47 blocks of one row, 16 of three, one
        monkeypatch.setattr(blocks, "BLOCK", pixels)
        for threads in (1, 2, 7):
            np.testing.assert_array_equal(expose(photons, sensor, EXPOSURE, seed=7, view=1, threads=threads).dn, whole)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_memory_layout_and_width_of_the_light_do_not_matter(dtype):
    sensor = Sensor(**BASE)
    photons = np.round(light(3)).astype(dtype)
    frame = expose(photons, sensor, EXPOSURE, seed=7, view=1)
    turned = expose(np.asfortranarray(photons), sensor, EXPOSURE, seed=7, view=1)
    np.testing.assert_array_equal(frame.dn, turned.dn)
    np.testing.assert_array_equal(frame.dn, expose(photons.astype(np.float64), sensor, EXPOSURE, seed=7, view=1).dn)


@pytest.mark.parametrize("corner", [(0, 0), (2, 4), (3, 5), (1, 0), (0, 1)])
def test_a_crop_is_the_crop_of_the_whole_frame_at_any_offset(corner):
    """Row blocks need no alignment, and neither do regions of interest: each pixel owns its draws."""
    sensor = Sensor(**(BASE | CHAINS["fixed pattern"] | CHAINS["defects"] | {"sigma_row": 1.0, "sigma_column": 1.0}))
    photons = light(3)
    whole = expose(photons, sensor, Exposure(time=0.1), seed=7, view=1)
    y, x = corner
    part = expose(photons[y:, x:], sensor, Exposure(time=0.1, origin=corner), seed=7, view=1)
    np.testing.assert_array_equal(part.dn, whole.dn[y:, x:])
    # near saturation the analytic mean is summed over a grid of charges that the other pixels help to choose
    np.testing.assert_allclose(part.mean_dn, whole.mean_dn[y:, x:], rtol=1e-5)


def test_importing_the_package_stays_light():
    heavy = "{'numba', 'torch', 'colour', 'matplotlib', 'cv2', 'pidng', 'rawpy', 'scipy.stats', 'mitsuba'}"
    code = f"import sys, sensor_model; print(sorted({heavy} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def run(kernel, u, mean):
    """One kernel over any number of pixels; float64 results, and float32 ones."""
    from sensor_model.fast.kernels import CHUNK, MU, N, U, W

    b, f, where = blocks.scratch()
    f[:] = 0  # not every kernel leaves quantiles, and what lay in that memory may not be castable
    counts, quantiles, bounded = np.empty(u.size), np.empty(u.size), True
    for i in range(0, u.size, CHUNK):
        n = min(CHUNK, u.size - i)
        b[U : U + n], b[MU : MU + n] = u[i : i + n], mean[i : i + n]
        bounded &= bool(kernel(b, f, n)) if kernel.__name__ == "normal32" else kernel(b, f, n, where) is None
        counts[i : i + n], quantiles[i : i + n] = b[N : N + n], f[W : W + n]
    return counts, quantiles, bounded


def test_single_precision_quantiles_keep_their_stated_error():
    """Rationale: frames equal those of float64 only if nothing is further off than `NORMAL_ERROR` says."""
    from scipy.special import ndtri

    from sensor_model.fast.kernels32 import NORMAL_ERROR, TAIL, normal32

    tail = np.exp(np.linspace(np.log(1.001 * TAIL), np.log(0.5), 100_000))
    u = np.concatenate([tail, 1 - tail, 0.5 + np.linspace(-1e-3, 1e-3, 2000)])
    _, found, bounded = run(normal32, u, np.ones(u.size))
    assert bounded
    assert (np.abs(found - ndtri(u)) <= 0.5 * NORMAL_ERROR * (1 + np.abs(ndtri(u)))).all()
    assert not run(normal32, np.append(u, 0.5 * TAIL), np.ones(u.size + 1))[2]


@pytest.mark.parametrize("order", ["mixed", "sorted"])
def test_poisson_counts_are_exact_though_found_in_single_precision(order):
    """Means from 1e-9 to 1e7 and numbers far into both tails, side by side and on their own."""
    from sensor_model import effects
    from sensor_model.fast.poisson import poisson

    rng = np.random.default_rng(0)
    mean = np.exp(rng.uniform(np.log(1e-9), np.log(1e7), 150_000))
    mean[::9] = 10 ** rng.uniform(-1, 2.5, mean[::9].size)
    mean = np.sort(mean) if order == "sorted" else mean
    u = rng.random(mean.size)
    u[::5] = 2.0 ** -rng.uniform(1, 45, u[::5].size)
    u[1::5] = 1 - 2.0 ** -rng.uniform(1, 30, u[1::5].size)
    counts, _, _ = run(poisson, u, mean)
    np.testing.assert_array_equal(counts, effects.shot_noise(u, mean))


@pytest.mark.parametrize("shot", ["poisson", "normal", "none"])
@pytest.mark.parametrize("chain", ["plain", "dual gain", "heavy tails", "no read noise"])
def test_unchecked_single_precision_moves_few_codes_and_those_by_one(chain, shot):
    sensor = Sensor(**(BASE | CHAINS[chain]))
    photons = light(1, (600, 700))
    whole = expose(photons, sensor, EXPOSURE, seed=7, view=1, shot=shot).dn.astype(int)
    single = expose(photons, sensor, EXPOSURE, seed=7, view=1, shot=shot, precision="float32").dn.astype(int)
    moved = np.abs(whole - single)
    width = sensor.dual_gain.ratio if sensor.dual_gain else 1
    assert moved.max() <= width
    noise = sensor.gain * (sensor.sigma_d + np.sqrt(np.minimum(sensor.eta * photons, sensor.mu_e_sat)))
    few = 1e-6 * noise.sum()  # the docstring's code in a million for each DN of noise
    assert np.count_nonzero(moved) < few + 5 * np.sqrt(few)
    if chain == "no read noise" and shot != "normal":
        assert not moved.any()
    with pytest.raises(ValueError, match="precision must be one of"):
        expose(photons, sensor, EXPOSURE, seed=7, view=1, precision="half")


def test_a_number_far_in_the_tail_is_taken_in_double_precision():
    """Seed 195 draws 9e-9 (5.6 deviations) at row 224, column 450, where the float32 quantile has no bound."""
    sensor = Sensor(**(BASE | {"gain": 1500.0, "sigma_d": 1.0, "bits": 16, "black_level": 2e4, "mu_e_sat": 50.0}))
    exposure = Exposure(time=0.1, origin=(224, 440))
    for level in np.linspace(0, 1, 200):
        how = {"seed": 195, "view": 0, "shot": "none"}
        fast, plain = (
            expose(np.full((1, 20), level), sensor, exposure, **how, backend=b).dn for b in ("numba", "numpy")
        )
        np.testing.assert_array_equal(fast, plain)


def test_a_code_is_in_doubt_within_a_share_of_the_loudest_read_noise_in_codes() -> None:
    def margin(sigma: float, gain: float, sigma_low: float) -> float:
        return capture_fused._noise((0.0, 0.0, sigma, 0.0, gain, 0.0, 0.0, sigma_low, 0.0), None, False)[1]

    one = margin(1.0, 1.0, 0.0)
    assert one > 0
    assert margin(3.0, 1.0, 2.0) == margin(2.0, 1.0, 3.0) == pytest.approx(3 * one)
    assert margin(3.0, 5.0, 2.0) == pytest.approx(15 * one)
