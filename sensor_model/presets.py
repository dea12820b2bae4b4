"""Real cameras. `SOURCES` gives the origin of each value of each preset; units as in `Sensor`.

FRAMOS: EMVA 1288 release 3.1 reports of the Sony IMX900 (2.25 um pixels, 36 deg C, 536 nm).
PMN: megvii-research/PMN (Apache-2.0), data_process/process.py: photon transfer and dark frames per ISO.
ELD: Vandermode/ELD (MIT), camera_params/release: log-linear fits against the gain; profile 2 of the D850.
Prime 95B: getframes (MIT), fitted from 200 dark frames per exposure at -20 deg C, low-signal leg of its 16-bit mode.
PMN and ELD give noise in DN, and for Tukey's lambda distribution its scale: sigma = scale * tukey_sd(lambda) / gain.
Quantum efficiency: no source has a curve over the wavelength; `SOURCES[...]["eta"]` says at which wavelength it was
measured, if it was. Colour goes through `rgb_response`.
"assumed": no public measurement. An assumed `eta` matters only for light in physical units: light given in electrons
divides it out. "derived": the range of the ADC at the lowest ISO; at the ISO of the preset the ADC saturates first.
"""

from __future__ import annotations

from dataclasses import fields, replace
from math import exp, log

from sensor_model.effects import tukey_sd
from sensor_model.params import Defects, Sensor

# Relative sensitivities of Bayer filters on silicon under daylight, and a usual quantum efficiency; assumed.
DAYLIGHT = (0.55, 1.0, 0.65)
ASSUMED_QE = 0.6

PRESETS: dict[str, Sensor] = {}
SOURCES: dict[str, dict[str, str]] = {}


def _add(name: str, sensor: Sensor, source: str, **exceptions: str) -> None:
    plain = replace(sensor, cfa=None)
    for key, value in ((name, sensor), (f"{name}-3chip", plain)):
        PRESETS[key] = value
        used = [f.name for f in fields(value) if getattr(value, f.name) != f.default]
        SOURCES[key] = {field: exceptions.get(field, source) for field in used}


_COLOUR = {"rgb_response": "assumed", "cfa": "assumed", "serial": "arbitrary"}
_UNPUBLISHED = {"eta": "assumed", "mu_e_sat": "derived"} | _COLOUR


# FRAMOS gives the dark current for high gain only; it belongs to the photodiode and does not depend on the gain.
for _name, _gain, _eta, _sigma_d, _full, _dsnu, _prnu in (
    ("lcg", 0.399, 0.9125, 5.56, 9458.0, 3.7, 0.007),
    ("hcg", 1.673, 0.8847, 1.954, 2183.0, 1.3, 0.008),
):
    _imx900 = Sensor(
        gain=_gain, eta=_eta, mu_e_sat=_full, black_level=240.0, bits=12, sigma_d=_sigma_d, dsnu=_dsnu, prnu=_prnu,
        dark_current=1.473, dark_temperature=36.0, rgb_response=DAYLIGHT, serial=900,
    )  # fmt: skip
    _add(f"imx900-{_name}", _imx900, "FRAMOS", dark_doubling="assumed", eta="FRAMOS, at 536 nm", **_COLOUR)

# PMN, Sony A7S II, 14 bit: gain, lambda, Tukey scale, row noise. Dual gain switches between ISO 1600 and 2000.
A7S2 = {
    100: (0.09563, 0.14875287, 0.70181876, 0.1391465),
    200: (0.19126, 0.07902429, 0.8117464, 0.22815849),
    400: (0.38252, 0.0222538, 1.1816813, 0.36209714),
    800: (0.76504, -0.008199721, 1.9346539, 0.5723769),
    1600: (1.53008, -0.0441045, 3.2283993, 0.988786),
    2000: (1.9126, -0.012963797, 1.4356787, 0.33124214),
    3200: (3.06016, -0.034863412, 2.0417721, 0.44543457),
    6400: (6.12032, -0.07517104, 3.4502964, 0.7218788),
    12800: (12.24064, -0.06495205, 7.038261, 1.2749791),
    25600: (24.48128, -0.09089118, 12.175712, 2.2760193),
}
for _iso, (_gain, _lam, _scale, _row) in A7S2.items():
    _a7s2 = Sensor(
        gain=_gain, eta=ASSUMED_QE, mu_e_sat=166_000.0, black_level=512.0, bits=14, rgb_response=DAYLIGHT, serial=72,
        sigma_d=_scale * tukey_sd(_lam) / _gain, tukey_lambda=_lam, sigma_row=_row / _gain,
    )  # fmt: skip
    _add(f"a7s2-iso{_iso}", _a7s2, "PMN", **_UNPUBLISHED)

# PMN, Sony IMX385 in the CRVD video camera, 12 bit: gain, read variance in DN**2, error of the black level in DN.
# Read noise Gaussian; row noise exp(0.93368 ln K - 2.19692) DN.
IMX385 = {
    1600: (3.513262, 11.917691, -1.1266),
    3200: (6.955588, 38.117816, -1.69546),
    6400: (13.486051, 130.818508, -3.25935),
    12800: (26.585953, 484.53979, -6.68111),
    25600: (52.032536, 1819.818657, -12.66876),
}
for _iso, (_gain, _variance, _bias) in IMX385.items():
    _imx385 = Sensor(
        gain=_gain, eta=ASSUMED_QE, mu_e_sat=17_500.0, black_level=240.0, bits=12, rgb_response=DAYLIGHT, serial=385,
        sigma_d=_variance**0.5 / _gain, sigma_row=exp(0.93368 * log(_gain) - 2.19692) / _gain, rgb_bias=(_bias,) * 3,
    )  # fmt: skip
    _add(f"imx385-iso{_iso}", _imx385, "PMN", **_UNPUBLISHED)

# PMN, Sony IMX686 (telephone), 10 bit: log-linear fits of Gaussian sigma and row noise in DN against the gain, made for
# ISO 640 to 6400. At ISO 6400 the fit says 12.51 DN, and its own scatter (0.029 of ln sigma) makes that agree
# with the 12.89 DN that PMN's table of the highest ISO measures (`get_camera_noisy_params_max`). A third table, which
# nothing in PMN calls (`get_specific_noise_params`: 0.693 DN at ISO 100, 14.30 DN at ISO 6400), lies 4.6 scatters above
# it, and disagrees with the second one as well: not taken.
_IMX686_READ = "PMN, get_camera_noisy_params: the fit over ISO 640 to 6400"
for _iso in (800, 1600, 6400):
    _gain = 8.74253 * _iso / 6400
    _imx686 = Sensor(
        gain=_gain, eta=ASSUMED_QE, mu_e_sat=7_000.0, black_level=64.0, bits=10, rgb_response=DAYLIGHT, serial=686,
        sigma_d=exp(0.85187 * log(_gain) + 0.67991) / _gain, tukey_lambda=0.102,
        sigma_row=exp(0.87611 * log(_gain) - 2.11455) / _gain,
    )  # fmt: skip
    _add(
        f"imx686-iso{_iso}",
        _imx686,
        "PMN",
        gain="PMN at ISO 6400, proportional to ISO",
        sigma_d=_IMX686_READ,
        **_UNPUBLISHED,
    )

# ELD, Nikon D850, profile 2, 14 bit; gain proportional to ISO between 0.4150 at 100 and 26.56 at 6400. ELD's list of
# lambdas (-0.24 to -0.10) does not say which ISO each belongs to: their middle.
for _iso in (400, 1600, 6400):
    _gain = 26.5625 * _iso / 6400
    _d850 = Sensor(
        gain=_gain, eta=ASSUMED_QE, mu_e_sat=60_000.0, black_level=400.0, bits=14, rgb_response=DAYLIGHT, serial=850,
        sigma_d=exp(0.95467 * log(_gain) + 0.18022) / _gain, tukey_lambda=-0.17,
        sigma_row=exp(0.96623 * log(_gain) - 2.69533) / _gain,
    )  # fmt: skip
    _add(f"d850-iso{_iso}", _d850, "ELD", **_UNPUBLISHED | {"black_level": "assumed", "tukey_lambda": "ELD, middle"})

# A monochrome scientific CMOS camera
_add(
    "prime-95b",
    Sensor(
        gain=1 / 0.7678, eta=0.95, mu_e_sat=80_000.0, black_level=100.0, bits=16, sigma_d=1.4658, prnu=0.005,
        nonlinearity=0.005, dark_current=0.413, dark_temperature=-20.0, cfa=None, serial=95,
        defects=Defects(rts_fraction=0.0145, rts_factor=2.729),
    ),
    "Prime 95B",
    eta="Prime 95B, its largest",
    serial="arbitrary",
)  # fmt: skip

# Photon noise only: one DN per electron
_add("ideal", Sensor(gain=1.0, eta=1.0, mu_e_sat=4095.0, black_level=0.0, bits=12), "by definition")
