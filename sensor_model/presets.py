"""Real cameras. Each number carries its source; `assumed` marks those no public source gives.

Sources:
    FRAMOS: EMVA 1288 release 3.1 reports of the Sony IMX900 (2.25 um, 36 deg C, 536 nm).
    PMN: megvii-research/PMN (Apache-2.0), data_process/process.py, calibrated per ISO; 14 bit. Its Tukey-lambda numbers
        are scales in DN: the standard deviation is scale * tukey_sd(lambda).
"""

from __future__ import annotations

from dataclasses import replace

from sensor_model.effects import tukey_sd
from sensor_model.params import Sensor

# Relative sensitivities of the filters under daylight; assumed (.55 to .65 is common for silicon with Bayer dyes).
DAYLIGHT = (0.55, 1.0, 0.65)


def _imx900(**values: float) -> Sensor:
    return Sensor(bits=12, black_level=240.0, rgb_response=DAYLIGHT, serial=900, **values)  # type: ignore[arg-type]


def _a7s2(gain: float, lam: float, scale_dn: float, row_dn: float) -> Sensor:
    """PMN's per-ISO calibration of the Sony A7S II, turned from DN into electrons."""
    return Sensor(
        gain=gain,
        eta=0.6,  # assumed: PMN calibrates electrons, not photons
        mu_e_sat=160_000.0,  # assumed, e-: just under what the ADC spans at ISO 100; higher ISO saturate in the ADC
        black_level=512.0,
        bits=14,
        sigma_d=scale_dn * tukey_sd(lam) / gain,
        tukey_lambda=lam,
        sigma_row=row_dn / gain,
        rgb_response=DAYLIGHT,
        serial=72,
    )


BAYER: dict[str, Sensor] = {
    # FRAMOS. Dark current is given for the high conversion gain only; it is a property of the same photodiode.
    "imx900-lcg": _imx900(
        gain=0.399, eta=0.9125, sigma_d=5.56, mu_e_sat=9458.0, dsnu=3.7, prnu=0.007, dark_current=1.473
    ),
    "imx900-hcg": _imx900(
        gain=1.673, eta=0.8847, sigma_d=1.954, mu_e_sat=2183.0, dsnu=1.3, prnu=0.008, dark_current=1.473
    ),
    # PMN: Kmax, lam, sigTL, sigR
    "a7s2-iso1600": _a7s2(1.53008, -0.0441045, 3.2283993, 0.988786),
    "a7s2-iso6400": _a7s2(6.12032, -0.07517104, 3.4502964, 0.7218788),
    "a7s2-iso25600": _a7s2(24.48128, -0.09089118, 12.175712, 2.2760193),
    # Photon noise and nothing else: every electron counts one DN.
    "ideal": Sensor(gain=1.0, eta=1.0, mu_e_sat=4095.0, black_level=0.0, bits=12),
}

PRESETS: dict[str, Sensor] = BAYER | {f"{name}-3chip": replace(sensor, cfa=None) for name, sensor in BAYER.items()}
