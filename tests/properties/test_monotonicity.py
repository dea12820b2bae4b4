"""More light is never worse, as long as nothing saturates; and no pixel gets darker by it, whatever the camera."""

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from sensor_model import Exposure, Sensor, expose, raw_noise

EXPOSURE = Exposure(time=0.02)
seeds = st.integers(0, 2**32 - 1)


@st.composite
def cameras(draw: st.DrawFn, least_noise: float = 0.0) -> Sensor:
    """Any camera without a second gain, whose switch adds noise, and without charge that moves between pixels.

    `least_noise`: of the readout, DN.
    """
    gain = draw(st.floats(0.02, 30))
    return Sensor(
        gain=gain, eta=draw(st.floats(0.05, 1)), bits=draw(st.integers(8, 16)), black_level=draw(st.floats(0, 100)),
        mu_e_sat=draw(st.floats(50, 1e5)), sigma_d=least_noise / gain + draw(st.floats(0, 20)),
        tukey_lambda=draw(st.none() | st.floats(-0.2, 0.5)), dark_current=draw(st.floats(0, 1000)),
        nonlinearity=draw(st.floats(0, 0.2)), sigma_row=draw(st.floats(0, 3)), cfa=None,
    )  # fmt: skip


levels = st.lists(st.floats(0, 1), min_size=12, max_size=12, unique=True).map(sorted)


# Below 0.8 DN of noise the steps of the ADC show: the variance of a code goes up and down with every DN.
@given(camera=cameras(least_noise=0.8), shares=levels)
def test_more_light_never_lowers_the_ratio_of_signal_to_noise_below_saturation(
    camera: Sensor, shares: list[float]
) -> None:
    light = np.array([[0.0, *shares]]) * camera.capacity_e / camera.eta
    frame = expose(light, camera, EXPOSURE, seed=0, view=0)
    mean, sd = frame.mean_dn[0].astype(float), np.sqrt(frame.variance_dn[0].astype(float))
    clear = (mean + 9 * sd < camera.white_dn) & (mean - 9 * sd > 0)  # nothing of the distribution is clipped
    assume(clear.sum() > 2)
    ratio = ((mean - mean[0]) / sd)[clear]
    rounding = 1e-6 * mean[clear].max() / sd[clear].min()  # of float32 moments
    assert (np.diff(ratio) >= -rounding - 1e-5 * ratio[:-1]).all()


@given(camera=cameras(), shares=levels)
def test_more_light_never_lowers_the_mean_of_a_pixel(camera: Sensor, shares: list[float]) -> None:
    light = np.array([shares]) * 3 * min(camera.capacity_e, 2000) / camera.eta
    mean = expose(light, camera, EXPOSURE, seed=0, view=0).mean_dn[0].astype(float)
    assert (np.diff(mean) >= -1e-5 * (1 + mean[:-1])).all()


@given(
    camera=cameras(), seed=seeds, low=st.floats(0, 1), high=st.floats(0, 1), shot=st.sampled_from(["poisson", "none"])
)
def test_the_same_draws_under_more_light_lower_no_code(
    camera: Sensor, seed: int, low: float, high: float, shot: str
) -> None:
    """Each draw is the inverse of a distribution function, so this holds pixel by pixel, not only on average."""
    low, high = sorted((low, high))
    shape, full = (20, 20), 2 * camera.capacity_e / camera.eta
    dark, bright = (
        expose(np.full(shape, share * full), camera, EXPOSURE, seed=seed, view=0, shot=shot).dn.astype(int)  # type: ignore[arg-type]
        for share in (low, high)
    )
    assert (bright >= dark).all()


@given(camera=cameras(), shares=levels)
def test_what_methods_are_told_of_the_noise_never_falls_with_light(camera: Sensor, shares: list[float]) -> None:
    """Without droop, which bends the curve down again near a full well."""
    assume(camera.nonlinearity < 0.05)
    curve = raw_noise(camera, EXPOSURE, channels=1)
    variance = curve.variance(camera.black_level + np.array(shares) * (camera.white_dn - camera.black_level))
    assert (np.diff(variance) >= -1e-12 * variance[:-1]).all()
