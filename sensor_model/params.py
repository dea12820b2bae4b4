"""The camera (`Sensor`) and how it is used (`Exposure`).

Symbols follow EMVA 1288: `mu_e` is a mean charge, `sigma_d` the temporal dark noise, `mu_e_sat` the saturation
capacity; EMVA's K is spelled `gain` and is always DN/e-. Noise amplitudes are in electrons. Zero or `None` means off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Literal

Cfa = Literal["RGGB", "GRBG", "GBRG", "BGGR"]
CFAS: tuple[Cfa, ...] = ("RGGB", "GRBG", "GBRG", "BGGR")


ROUNDING = 1 / 12  # variance of rounding to whole codes, DN**2


LARGEST = 1e15  # of any amplitude or factor: far beyond sensors, and its square is still exact enough in float64


def require(ok: bool, what: str, rule: str, value: object, remedy: str = "") -> None:
    """Raise ValueError naming the quantity, the rule it breaks, and its value."""
    if not ok:
        raise ValueError(f"{what} must be {rule}, got {value!r}" + (f"; {remedy}" if remedy else ""))


def _require_not_negative(owner: object, *names: str) -> None:
    for name in names:
        value = getattr(owner, name)
        require(isfinite(value) and value >= 0, name, "finite and >= 0", value)
        require(value <= LARGEST, name, f"at most {LARGEST:g}", value)


def _is_spread(table: tuple[tuple[float, ...], ...]) -> bool:
    """Odd sides, so that it has a middle; no light is lost or gained."""
    odd = len(table) % 2 == 1 and all(len(row) == len(table[0]) for row in table) and len(table[0]) % 2 == 1
    shares = [share for row in table for share in row]
    return odd and all(isfinite(s) and s >= 0 for s in shares) and abs(sum(shares) - 1) < 1e-6


@dataclass(frozen=True, kw_only=True)
class SensorOptics:
    """The effects of the lens and of the stack above the photodiodes on the light."""

    corner_angle: float = 0.0  # degrees; relative illumination falls as cos**4 up to this angle in the corners
    falloff: tuple[float, ...] | None = None  # or: relative illumination at even steps from centre to corner
    crosstalk: float = 0.0  # share of a pixel's light that each of its four neighbours receives
    psf: tuple[tuple[float, ...], ...] | None = None  # or: where the light of one pixel goes, odd x odd shares of sum 1
    sensor_shape: tuple[int, int] | None = None  # rows, columns of the whole sensor; None: the frame is the sensor

    def __post_init__(self) -> None:
        """Check every field."""
        require(0 <= self.corner_angle < 90, "corner_angle", "in [0, 90) degrees", self.corner_angle)
        require(0 <= self.crosstalk <= 0.2, "crosstalk", "in [0, 0.2]", self.crosstalk, "0.2 blurs evenly over five")
        require(self.psf is None or _is_spread(self.psf), "psf", "None or odd x odd shares >= 0 of sum 1", self.psf)
        require(self.psf is None or self.crosstalk == 0, "crosstalk", "0 beside a psf", self.crosstalk)
        table = self.falloff
        ok = table is None or (len(table) >= 2 and all(isfinite(v) and v >= 0 for v in table))
        require(ok, "falloff", "None or at least two numbers >= 0", table)
        full = self.sensor_shape
        ok = full is None or (len(full) == 2 and all(isinstance(n, int) and n >= 1 for n in full))
        require(ok, "sensor_shape", "None or (rows, columns), whole and >= 1", full)
        require(table is None or self.corner_angle == 0, "corner_angle", "0 beside a falloff table", self.corner_angle)


@dataclass(frozen=True, kw_only=True)
class Defects:
    """Pixels that differ from the rest; the serial of the camera determines which ones."""

    hot_fraction: float = 0.0  # of the pixels
    hot_factor: float = 1.0  # dark current of a hot pixel over the other pixels'
    rts_fraction: float = 0.0  # of the pixels: random telegraph signal
    rts_factor: float = 1.0  # standard deviation of such a pixel's read noise over the other pixels'
    rts_traps: int = 1  # independent traps in such a pixel: its signal jumps between 2 traps + 1 levels

    def __post_init__(self) -> None:
        """Check every field."""
        for name in ("hot_fraction", "rts_fraction"):
            require(0 <= getattr(self, name) <= 1, name, "in [0, 1]", getattr(self, name))
        for name in ("hot_factor", "rts_factor"):
            value = getattr(self, name)
            require(isfinite(value) and value >= 1, name, "finite and >= 1", value)
        require(self.rts_traps in range(1, 65), "rts_traps", "a whole number from 1 to 64", self.rts_traps)


@dataclass(frozen=True, kw_only=True)
class Banding:
    """Periodic row pattern whose phase is random in every frame (mains or supply ripple)."""

    amplitude: float  # e-, peak
    period: float  # rows

    def __post_init__(self) -> None:
        """Check every field."""
        _require_not_negative(self, "amplitude")
        require(isfinite(self.period) and self.period >= 2, "period", ">= 2 rows", self.period, "less aliases")


@dataclass(frozen=True, kw_only=True)
class DualGain:
    """In-pixel dual gain, merged to one linear scale: charges above the threshold are read at the low gain."""

    threshold: float  # e-
    sigma_d: float  # read noise at the low gain, e-
    ratio: float  # high over low gain: the low-gain code is this many DN wide

    def __post_init__(self) -> None:
        """Check every field."""
        _require_not_negative(self, "threshold", "sigma_d")
        require(isfinite(self.ratio) and self.ratio >= 1, "ratio", ">= 1", self.ratio)


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """One camera at one gain setting. Its fixed pattern follows from `serial` alone.

    Raises:
        ValueError: naming the field, the rule and the value, if a field is out of range.
    """

    gain: float  # DN/e-, EMVA's K
    eta: float  # quantum efficiency of the green channel, 0..1
    mu_e_sat: float  # full well, e-; math.inf: the ADC alone saturates
    black_level: float  # DN
    bits: int  # of the ADC, 8..16
    sigma_d: float = 0.0  # standard deviation of the read noise (not a Tukey scale: see `tukey_sd`), e-
    tukey_lambda: float | None = None  # shape of the read noise; None: Gaussian
    sigma_row: float = 0.0  # temporal row noise, e-
    sigma_column: float = 0.0  # temporal column noise, e-
    dsnu: float = 0.0  # spatial standard deviation of the dark offset, e-
    prnu: float = 0.0  # spatial standard deviation of the relative response
    dark_current: float = 0.0  # e-/s at `dark_temperature`
    dark_temperature: float = 20.0  # deg C
    dark_doubling: float = 6.0  # K; the dark current doubles with every such step
    nonlinearity: float = 0.0  # relative loss of response at full well
    blooming: bool = False  # charge over full well spills along its column
    coupling: float = 0.0  # electrical crosstalk: share of a pixel's charge that each of its four neighbours shows
    cfa: Cfa | None = "RGGB"  # None: no mosaic (monochrome, or three chips)
    rgb_response: tuple[float, float, float] = (1.0, 1.0, 1.0)  # relative sensitivities of the filters, g = 1
    rgb_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)  # error of the black level of each colour, DN
    banding: Banding | None = None
    defects: Defects | None = None
    optics: SensorOptics | None = None
    dual_gain: DualGain | None = None
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, hash=False)  # from outside: their settings
    serial: int = 0  # which copy of this camera: seeds the fixed pattern

    def __post_init__(self) -> None:
        """Check every field."""
        require(isfinite(self.gain) and self.gain > 0, "gain", "finite and > 0 DN/e-", self.gain)
        require(1 / LARGEST <= self.gain <= LARGEST, "gain", f"in [{1 / LARGEST:g}, {LARGEST:g}] DN/e-", self.gain)
        require(0 < self.eta <= 1, "eta", "in (0, 1]", self.eta, "give 0.6 for 60 %")
        require(self.mu_e_sat >= 1, "mu_e_sat", ">= 1 e-", self.mu_e_sat)
        require(self.bits in range(8, 17), "bits", "a whole number from 8 to 16", self.bits)
        require(0 <= self.black_level < self.max_dn, "black_level", f"in [0, {self.max_dn}) DN", self.black_level)
        _require_not_negative(self, "sigma_d", "sigma_row", "sigma_column", "dsnu", "prnu", "dark_current")
        # The response factor 1 + prnu * normal is cut at zero; above 0.2 that cut would move its mean.
        require(self.prnu <= 0.2, "prnu", "at most 0.2", self.prnu, "give 0.008 for 0.8 %")
        require(isfinite(self.dark_temperature), "dark_temperature", "finite, deg C", self.dark_temperature)
        require(self.dark_doubling > 0, "dark_doubling", "> 0 K", self.dark_doubling)
        # Tukey's lambda distribution has no finite variance at -1/2 and below, so no sigma_d.
        lam = self.tukey_lambda
        require(lam is None or -0.5 < lam < 2, "tukey_lambda", "None or in (-0.5, 2)", lam)
        # From 1/2 on, more light would give less signal.
        require(0 <= self.nonlinearity < 0.5, "nonlinearity", "in [0, 0.5)", self.nonlinearity)
        ok = self.nonlinearity == 0 or isfinite(self.mu_e_sat)
        require(ok, "mu_e_sat", "finite beside a nonlinearity, which is relative to it", self.mu_e_sat)
        require(self.blooming in (True, False), "blooming", "True or False", self.blooming)
        require(0 <= self.coupling <= 0.2, "coupling", "in [0, 0.2]", self.coupling, "0.2 blurs evenly over five")
        require(self.cfa is None or self.cfa in CFAS, "cfa", f"None or one of {CFAS}", self.cfa)
        response, bias = self.rgb_response, self.rgb_bias
        ok = len(response) == 3 and all(1 / LARGEST <= r <= LARGEST for r in response) and response[1] == 1
        require(ok, "rgb_response", f"three numbers in {1 / LARGEST:g}..{LARGEST:g} with green = 1", response)
        require(len(bias) == 3 and all(map(isfinite, bias)), "rgb_bias", "three finite numbers, DN", bias)
        require(0 <= self.serial < 2**64, "serial", "in [0, 2**64)", self.serial)
        ok = isinstance(self.effects, Mapping) and all(isinstance(of, Mapping) for of in self.effects.values())
        require(ok, "effects", "settings of each effect, by its name", self.effects)

    @property
    def max_dn(self) -> int:
        """The highest code of the ADC, DN."""
        return (1 << self.bits) - 1

    @property
    def white_dn(self) -> float:
        """The code at which a pixel saturates, by charge or by ADC, whichever comes first. DN."""
        full = self.mu_e_sat * (1 - self.nonlinearity)
        return min(float(self.max_dn), self.black_level + self.gain * full)

    @property
    def capacity_e(self) -> float:
        """The signal at which a pixel saturates, by full well or by ADC. e-."""
        return (self.white_dn - self.black_level) / self.gain

    @property
    def droop(self) -> float:
        """Factor of the quadratic term of the response, q - droop q**2. 1/e-."""
        return self.nonlinearity / self.mu_e_sat

    def dark_e(self, exposure: Exposure) -> float:
        """Mean dark charge of one exposure, e-. EMVA 1288: the dark current doubles every `dark_doubling` kelvin."""
        at = self.dark_temperature if exposure.temperature is None else exposure.temperature
        doublings = (at - self.dark_temperature) / self.dark_doubling
        require(doublings < 100, "temperature", "less than 100 doublings above dark_temperature", at, "check both")
        return self.dark_current * exposure.time * 2.0**doublings


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """How one frame is taken."""

    time: float  # s
    temperature: float | None = None  # of the sensor, deg C; None: where its dark current was measured
    origin: tuple[int, int] = (0, 0)  # row, column of the frame's first pixel on the sensor (region of interest)
    line_time: float = 0.0  # s from one row's start to the next: rolling shutter; 0: global shutter

    def __post_init__(self) -> None:
        """Check every field."""
        _require_not_negative(self, "time", "line_time")
        ok = self.temperature is None or isfinite(self.temperature)
        require(ok, "temperature", "None or finite, deg C", self.temperature)
        require(len(self.origin) == 2 and min(self.origin) >= 0, "origin", "(row, column) >= 0", self.origin)
