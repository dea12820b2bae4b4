"""Hard cases of the camera: no light and far too much, clipping, rounding, odd sizes, threads.

The reference is rational arithmetic.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from sensor_model import capture, effects, isp
from sensor_model.capture import clean_response
from sensor_model.fast import capture_fused
from sensor_model.frame import prepare
from sensor_model.isp import develop, develop_linear
from sensor_model.mosaicking import mosaic
from sensor_model.params import CFAS, DualGain, Sensor
from sensor_model.presets import PRESETS
from tests.stability.case import EPS, Case, Error, Fails, Part, Setting, refusal, worse
from tests.stability.sensor.frames import BOTH, CAMERA, DIFFER, EXPOSURE, differ, frame

PART = Part("sensor")
SILENT = replace(CAMERA, eta=1.0, sigma_d=0.0, mu_e_sat=math.inf)


@PART.case("light of 0, -0, and less than the smallest number: a dark frame", bound=0, unit=DIFFER, backends=BOTH)
def _(setting: Setting) -> float:
    dark = frame(np.zeros((64, 64)), CAMERA, setting)
    worst = 0.0
    for level in (-0.0, 5e-324, 1e-310, 1e-30):
        shot = frame(np.full((64, 64), level), CAMERA, setting)
        moments = np.abs([shot.mean_dn - dark.mean_dn, shot.variance_dn - dark.variance_dn]).max()
        worst = worse(worst, differ(shot.dn, dark.dn) + float(moments))  # NaN does not hold either
    return worst


@PART.case("light that is nan, infinite or negative: refused with its count", bound=0, unit="refused", backends=BOTH)
def _(setting: Setting) -> float:
    worst = 0.0
    for bad in (math.nan, math.inf, -math.inf, -1.0, -1e-12):
        light = np.full((30, 40), 5.0)
        light[7, 11] = light[20, 0] = bad
        told = ("photons must be finite and >= 0", "(7, 11)", "(2 of 1200 values)")
        worst = worse(worst, refusal(lambda light=light: frame(light, CAMERA, setting), *told))
    return worst


@PART.case(
    "light of 1e6 to 1.7e308: every pixel full, no overflow", bound=2.5e-4, unit="DN of 3664", backends=BOTH
)  # float32 holds 3664 DN to 1.2e-4
def _(setting: Setting) -> float:
    worst = 0.0
    for level in (1e6, 1e15, 1e19, 1e38, 1.7e308):
        shot = frame(np.full((32, 32), level), CAMERA, setting)
        uneven = frame(np.full((32, 32), level), replace(CAMERA, eta=1.0, prnu=0.1), setting)
        error = float(np.abs(shot.mean_dn.astype(np.float64) - CAMERA.white_dn).max())
        astray = abs(float(shot.dn.mean()) - CAMERA.white_dn) > 5 * 3 / 32  # 3 DN of read noise, 32 x 32 pixels
        worst = worse(worst, error + astray + (~shot.saturated).sum() + (~uneven.saturated).sum())
    return worst


def _code(charge: Fraction, camera: Sensor) -> int:
    """The code of a charge without noise: Python's own rounding of fractions, which goes half to even."""
    held = charge if math.isinf(camera.mu_e_sat) else min(charge, Fraction(camera.mu_e_sat))
    signal, low = Fraction(camera.gain) * held + Fraction(camera.black_level) + Fraction(camera.rgb_bias[1]), 1
    if camera.dual_gain is not None and held > camera.dual_gain.threshold:
        low = int(camera.dual_gain.ratio)
    return min(max(round(signal / low) * low, 0), camera.max_dn)


@PART.case("codes below 0 and beyond 16 bits: clipped, then cast", bound=0, unit=DIFFER, backends=BOTH)
def _(setting: Setting) -> float:
    camera = replace(SILENT, bits=16, gain=500.0, black_level=0, rgb_bias=(-700.0,) * 3)
    light = np.array([[0.0, 1, 2, 3, 130, 132, 133, 141, 1e3, 1e5, 1e9]])
    codes = [[_code(Fraction(mean), camera) for mean in light[0]]]
    return differ(frame(light, camera, setting, shot="none").dn, np.array(codes))


@PART.case("signals half way between two codes: to the even one", bound=0, unit=DIFFER, backends=BOTH)
def _(setting: Setting) -> float:
    light = np.arange(0, 900, 0.25)[None]
    plain = replace(SILENT, gain=0.5)
    # A code of the low gain is 6 DN wide: half of it is 3 DN, a charge of 12 apart.
    merged = replace(plain, dual_gain=DualGain(threshold=400, sigma_d=0, ratio=6))
    worst = 0.0
    for camera in (plain, merged):
        codes = np.array([[_code(Fraction(mean), camera) for mean in light[0]]])
        worst = worse(worst, differ(frame(light, camera, setting, shot="none").dn, codes))
    return worst


@PART.case("full pixels: charge clips, then the ADC, then white balance", bound=EPS, unit="of white",
           backends=BOTH)  # fmt: skip
def _(setting: Setting) -> float:
    worst = 0.0
    for full in (1800.0, math.inf):
        camera = replace(SILENT, mu_e_sat=full, rgb_response=(1.4, 1.0, 0.7))
        light = np.stack([np.geomspace(0.1, 1e6, 64)] * 3, -1)[None] * camera.rgb_response
        span = Fraction(camera.white_dn) - Fraction(camera.black_level)
        balance = [max(camera.rgb_response) / response for response in camera.rgb_response]
        wanted = np.array([
            [float((_code(Fraction(light[0, i, c]), camera) - 64) / span) * balance[c] for c in range(3)]
            for i in range(64)
        ])  # fmt: skip
        shot = frame(light, camera, setting, shot="none")
        worst = worse(worst, float(np.abs(develop_linear(shot.dn, camera)[0] - wanted).max()) / max(balance))
        worst += float((develop(shot, camera).srgb8[0, -8:] != 255).sum())  # pink highlights
    return worst


@PART.case("odd sizes and all four filter patterns: an even colour stays even", bound=2e-6, unit="of the colour",
           backends=BOTH)  # fmt: skip
def _(setting: Setting) -> float:
    """Blue is 12 DN over black, which float32 holds at 300 DN to 1.5e-5."""
    worst, colour = 0.0, np.array([30.0, 50.0, 20.0])
    for cfa in CFAS:
        camera = replace(PRESETS["imx900-hcg"], cfa=cfa, dark_current=0.0)
        for shape in ((2, 3), (3, 2), (5, 5), (31, 33)):
            light = mosaic(np.broadcast_to(colour * camera.rgb_response / camera.eta, (*shape, 3)), cfa)
            shot = frame(light, camera, setting)
            clean = develop_linear(shot.clean_dn, camera, demosaic="bilinear") * camera.capacity_e
            wanted = colour * max(camera.rgb_response)
            worst = worse(worst, float(np.abs(clean / wanted - 1).max()))
    return worst


@PART.case("the three noise-free channels of a mosaic from darkness to 1e12 photons: one of them is in the raw frame",
           bound=2.5e-4, unit="DN", backends=BOTH)  # fmt: skip
def _(setting: Setting) -> float:
    """The width of float32 at 4095 DN. The reference is exact: fractions, of the full well with its droop."""
    worst, rng = 0.0, np.random.default_rng(5)
    light = np.concatenate([np.zeros((2, 9, 3)), 10.0 ** rng.uniform(-9, 12, (9, 9, 3))])
    for cfa in CFAS:
        camera = replace(PRESETS["imx900-hcg"], cfa=cfa, nonlinearity=0.02)
        full, dark, gain = Fraction(camera.mu_e_sat), Fraction(camera.dark_e(EXPOSURE)), Fraction(camera.gain)
        held = [min(Fraction(camera.eta) * Fraction(mu) + dark, full) for mu in light.ravel()]
        exact = [Fraction(camera.black_level) + gain * (q - Fraction(0.02) * q * q / full) for q in held]
        wanted = np.array([float(dn) for dn in exact]).reshape(light.shape)
        three = clean_response(light, replace(camera, cfa=None), EXPOSURE)
        seen = frame(mosaic(light, cfa), camera, setting).clean_dn
        worst = worse(worst, float(np.abs(three - wanted).max()), float(np.abs(seen - mosaic(wanted, cfa)).max()))
    return worst


@PART.case("the same frame on 1, 2 and 7 threads", bound=0, unit=DIFFER, backends=("numba",))
def _(setting: Setting) -> float:
    camera = replace(PRESETS["imx900-hcg-3chip"], sigma_row=1.0, tukey_lambda=-0.1)
    light = np.geomspace(0.01, 1e5, 3 * 400 * 301).reshape(400, 301, 3)
    one = frame(light, camera, Setting("numba", 1)).dn
    return sum(differ(frame(light, camera, Setting("numba", n)).dn, one) for n in (setting.threads, 2, 7))


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def cast_first(signal: Any, max_dn: int, width: Any = 1.0) -> Any:
    with np.errstate(invalid="ignore"):
        return np.clip(np.rint(signal).astype(np.int64).astype(np.uint16), 0, max_dn)


def half_up(signal: Any, max_dn: int, width: Any = 1.0) -> Any:
    return np.clip(np.floor(np.floor(signal / width + 0.5) * width + 0.5), 0, max_dn).astype(np.uint16)


@pytest.mark.parametrize(
    ("module", "name", "naive", "case"),
    [
        (effects, "digitise", cast_first, "codes below 0"),
        (effects, "digitise", half_up, "signals half way"),
        (effects, "nonlinear", lambda electrons, droop: electrons, "the three noise-free channels"),
        (effects, "full_well", lambda charge, full: charge, "full pixels"),
        (isp, "white_balance", lambda sensor: np.ones(3), "full pixels"),
        (prepare, "charge_cap", lambda sensor, exposure: sensor.mu_e_sat, "light of 1e6"),
        (capture, "check_light", lambda light, what: None, "light that is nan"),
    ],
)  # fmt: skip
def test_a_formula_as_first_written_exceeds_its_bound(
    module: Any, name: str, naive: Callable, case: str, fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not fails(case)
    monkeypatch.setattr(module, name, naive)
    with np.errstate(all="ignore"):
        assert fails(case)


def test_draws_that_depend_on_what_was_drawn_before_show_in_the_frames_of_several_threads(
    fails: Fails,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    count = itertools.count()
    here = capture_fused.address
    monkeypatch.setattr(capture_fused, "address", lambda draws: (np.uint64(next(count)), *here(draws)[1:]))
    assert fails("the same frame")
