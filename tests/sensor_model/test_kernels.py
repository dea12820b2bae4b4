"""The fused kernels give, bit for bit, the frame of the numpy reference, however the work is cut."""

import subprocess
import sys

import numpy as np
import pytest

from sensor_model import Banding, Defects, DualGain, Exposure, Optics, Sensor, blocks, expose

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
    "optics": {"optics": Optics(corner_angle=30, crosstalk=0.02)},
    "dual gain": {"dual_gain": DualGain(threshold=800, sigma_d=20, ratio=6)},
    "nonlinear": {"nonlinearity": 0.03},
    "blooming": {"blooming": True},
    "coupling": {"coupling": 0.02, "nonlinearity": 0.01},
    "blooming and coupling": {"blooming": True, "coupling": 0.02},
    "point spread": {"optics": Optics(psf=((0.01, 0.05, 0.02), (0.04, 0.8, 0.08), (0.0, 0.0, 0.0)))},
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
