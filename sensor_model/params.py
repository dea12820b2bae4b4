"""The camera (`Sensor`) and how it is used (`Exposure`).

Symbols follow EMVA 1288: `mu_e` is a mean charge, `sigma_d` the temporal dark noise, `mu_e_sat` the saturation
capacity; EMVA's K is spelled `gain` and is always DN/e-. Noise amplitudes are in electrons. Zero or `None` means off.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Literal

Cfa = Literal["RGGB", "GRBG", "GBRG", "BGGR"]
CFAS: tuple[Cfa, ...] = ("RGGB", "GRBG", "GBRG", "BGGR")


def require(ok: bool, what: str, rule: str, value: object, remedy: str = "") -> None:
    """Raise ValueError naming the quantity, the rule it breaks, and its value."""
    if not ok:
        raise ValueError(f"{what} must be {rule}, got {value!r}" + (f"; {remedy}" if remedy else ""))


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
    sigma_d: float = 0.0  # standard deviation of the read noise, e-
    tukey_lambda: float | None = None  # shape of the read noise; None: Gaussian
    sigma_row: float = 0.0  # temporal row noise, e-
    dsnu: float = 0.0  # spatial standard deviation of the dark offset, e-
    prnu: float = 0.0  # spatial standard deviation of the relative response
    dark_current: float = 0.0  # e-/s
    cfa: Cfa | None = "RGGB"  # None: no mosaic (monochrome, or three chips)
    rgb_response: tuple[float, float, float] = (1.0, 1.0, 1.0)  # relative sensitivities of the filters, g = 1
    serial: int = 0  # which copy of this camera: seeds the fixed pattern

    def __post_init__(self) -> None:
        """Check every field."""
        require(isfinite(self.gain) and self.gain > 0, "gain", "finite and > 0 DN/e-", self.gain)
        require(0 < self.eta <= 1, "eta", "in (0, 1]", self.eta, "give 0.6 for 60 %")
        require(self.mu_e_sat >= 1, "mu_e_sat", ">= 1 e-", self.mu_e_sat)
        require(self.bits in range(8, 17), "bits", "a whole number from 8 to 16", self.bits)
        require(0 <= self.black_level < self.max_dn, "black_level", f"in [0, {self.max_dn}) DN", self.black_level)
        for name in ("sigma_d", "sigma_row", "dsnu", "prnu", "dark_current"):
            value = getattr(self, name)
            require(isfinite(value) and value >= 0, name, "finite and >= 0", value)
        # The response factor 1 + prnu * normal is cut at zero; above 0.2 that cut would move its mean.
        require(self.prnu <= 0.2, "prnu", "at most 0.2", self.prnu, "give 0.008 for 0.8 %")
        # Tukey's lambda distribution has no finite variance at -1/2 and below, so no sigma_d.
        lam = self.tukey_lambda
        require(lam is None or -0.5 < lam < 2, "tukey_lambda", "None or in (-0.5, 2)", lam)
        require(self.cfa is None or self.cfa in CFAS, "cfa", f"None or one of {CFAS}", self.cfa)
        response = self.rgb_response
        ok = len(response) == 3 and all(isfinite(r) and r > 0 for r in response) and response[1] == 1
        require(ok, "rgb_response", "three positive numbers with green = 1", response)
        require(0 <= self.serial < 2**64, "serial", "in [0, 2**64)", self.serial)

    @property
    def max_dn(self) -> int:
        """The highest code of the ADC, DN."""
        return (1 << self.bits) - 1

    @property
    def white_dn(self) -> float:
        """The code at which a pixel saturates, by charge or by ADC, whichever comes first. DN."""
        return min(float(self.max_dn), self.black_level + self.gain * self.mu_e_sat)

    @property
    def capacity_e(self) -> float:
        """The charge at which a pixel saturates, by full well or by ADC. e-."""
        return (self.white_dn - self.black_level) / self.gain


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """How one frame is taken."""

    time: float  # s
    origin: tuple[int, int] = (0, 0)  # row, column of the frame's first pixel on the sensor (region of interest)

    def __post_init__(self) -> None:
        """Check every field."""
        require(isfinite(self.time) and self.time >= 0, "time", "finite and >= 0 s", self.time)
        require(len(self.origin) == 2 and min(self.origin) >= 0, "origin", "(row, column) >= 0", self.origin)
