"""The EMVA 1288 package, written by others, measures our simulated cameras and must find what was put in.

Rationale: it estimates from frames alone, by the photon transfer method, and shares no code with us. Expectation:
gain and quantum efficiency within 0.5 %, dark noise and dark current within 1 %, DSNU and PRNU within 2 %, linearity
error under 0.05 %. Read noise is kept above 0.5 DN, below which rounding hides it from the method.
"""

import logging
from dataclasses import replace

import numpy as np
import pytest

from sensor_model import PRESETS, Exposure, Sensor, expose

SIZE = (256, 256)
CAMERAS = {
    "imx900-lcg": replace(PRESETS["imx900-lcg"], cfa=None),
    "imx900-hcg": replace(PRESETS["imx900-hcg"], cfa=None),
    "odd": Sensor(
        gain=0.83, eta=0.37, mu_e_sat=4900.0, black_level=61.0, bits=13, sigma_d=3.7, dsnu=2.1, prnu=0.013,
        dark_current=9.0, cfa=None, serial=4711,
    ),
}  # fmt: skip


def frames(sensor, photons, seconds, n, seed):
    """Frames of uniform light, each with a noise of its own."""
    light, exposure = np.full(SIZE, photons), Exposure(time=seconds)
    return [expose(light, sensor, exposure, seed=seed, view=0, frame=i).dn for i in range(n)]


def exposures(sensor):
    """Thirty times and the photons at each: up to saturation, with a dark signal of a sixth of full well."""
    longest = sensor.mu_e_sat / 6 / sensor.dark_current
    times = np.linspace(0.002, 1, 30) * longest
    return times, 1.08 * sensor.mu_e_sat / sensor.eta * times / longest


def measured(sensor, emva1288):
    def temporal(images):
        found = emva1288.routines.get_int_imgs(images)
        return {"sum": found["sum"].sum(), "pvar": found["pvar"].sum(), "dmean": found["dmean"]}

    raw = {"temporal": {}, "spatial": {}, "height": SIZE[0], "width": SIZE[1]}
    times, photons = exposures(sensor)
    for i, (t, p) in enumerate(zip(times, photons, strict=True)):
        dark, bright = (temporal(frames(sensor, q, t, 2, 2 * i + (q > 0))) for q in (0.0, p))
        raw["temporal"][t * 1e9] = {0.0: dark, p: bright}
    t, p = times[12], photons[12]
    stacks = {q: emva1288.routines.get_int_imgs(frames(sensor, q, t, 40, 1000 + (q > 0))) for q in (0.0, p)}
    raw["spatial"][t * 1e9] = stacks
    return emva1288.Results1288(emva1288.Data1288(raw, loglevel=logging.ERROR).data, loglevel=logging.ERROR)


@pytest.mark.parametrize("name", list(CAMERAS))
def test_emva1288_finds_the_parameters_that_were_put_in(name, emva1288):
    sensor = CAMERAS[name]
    found = measured(sensor, emva1288)
    assert pytest.approx(sensor.gain, rel=0.005) == found.K
    assert pytest.approx(100 * sensor.eta, rel=0.005) == found.QE
    assert found.sigma_d == pytest.approx(sensor.sigma_d, rel=0.01)
    assert found.u_I_mean == pytest.approx(sensor.dark_current, rel=0.01)
    assert pytest.approx(sensor.dsnu, rel=0.02) == found.DSNU1288
    assert pytest.approx(100 * sensor.prnu, rel=0.02) == found.PRNU1288
    assert found.u_e_sat == pytest.approx(sensor.mu_e_sat, rel=0.1)
    linearity = found.linearity()
    assert max(abs(linearity["linearity_error_min"]), abs(linearity["linearity_error_max"])) < 0.05
