"""What a frame begins with: the mean charge of its pixels, up to what fills every one of them."""

from dataclasses import replace

import numpy as np
import pytest

from sensor_model import Banding, Defects, DualGain, Exposure, Sensor
from sensor_model.frame import streams
from sensor_model.frame.prepare import charge_cap, prepare

EXPOSURE = Exposure(time=0.1)
CALM = Sensor(
    gain=3.0, eta=0.5, mu_e_sat=4000.0, black_level=100.0, bits=16, sigma_d=0.0, cfa=None, rgb_bias=(-5.0, -9.0, 2.0),
    nonlinearity=0.2,
)  # fmt: skip
LOUD = replace(
    CALM, sigma_d=2.0, sigma_row=3.0, sigma_column=1.0, dsnu=4.0, banding=Banding(amplitude=5.0, period=9),
    defects=Defects(rts_fraction=0.1, rts_factor=3.0), dual_gain=DualGain(threshold=1000.0, sigma_d=7.0, ratio=4.0),
)  # fmt: skip


@pytest.mark.parametrize(("sensor", "noise"), [(CALM, 0.0), (LOUD, 2 * 3 + 7 + 3 + 1 + 4 + 5)])
def test_beyond_full_well_all_noise_and_the_lowest_black_a_pixel_is_full_in_every_frame(sensor, noise):
    """4000 e- before the bend, and 9 DN below black are 3 e-."""
    top = 4000 + 20 * noise + 3
    assert charge_cap(sensor, EXPOSURE) == pytest.approx(top + 10 * np.sqrt(top) + 100)


def test_a_black_level_of_absurd_depth_keeps_the_cap_finite():
    assert charge_cap(replace(CALM, rgb_bias=(-1e300, 0.0, 0.0)), EXPOSURE) == pytest.approx(1e15, rel=1e-6)


def test_where_the_excess_goes_elsewhere_it_may_fill_the_longest_column():
    assert charge_cap(replace(CALM, blooming=True), EXPOSURE) == streams.SIDE * 4000.0


def test_the_mean_charge_follows_the_light_up_to_that_cap():
    light = np.array([[0.0, 10.0], [3000.0, 1e9]])
    found = prepare(light, CALM, EXPOSURE, streams.Draws(seed=0)).mean_charge[..., 0]
    np.testing.assert_allclose(found, [[0, 5], [1500, charge_cap(CALM, EXPOSURE)]])
