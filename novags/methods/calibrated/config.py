"""Settings of 3DGS4LL: of both branches, and of the first."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.splats.training.config import FitConfig

SOURCE = "3DGS4LL (2nd place of the NTIRE 2026 low-light 3D challenge), of which the repository tells the constants"
MEMORY = Memory(fixed=0.6e9, pictures=3.0, work=150.0)


@dataclass(frozen=True, kw_only=True)
class CalibratedConfig:
    """What both branches choose.

    Attributes:
        pictures: Which pictures it sees.
        fit: Of the Gaussians; harmonics of degree 2, as published.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        calibration: A file that `calibrate` made; None: of `a7s2-iso6400-3chip` on `tabletop`.
    """

    pictures: Pictures = "8bit"
    fit: FitConfig = field(default_factory=lambda: replace(ORIGINAL_FIT, sh_degree=2))
    init_scale: float = ORIGINAL_SCALE
    calibration: Path | None = None


@dataclass(frozen=True, kw_only=True)
class AmplifiedConfig(CalibratedConfig):
    """Branch 1: amplified pictures, smoothed, and the dark ones behind the camera's model.

    Attributes:
        gain: Times the gamma of a dark code; with the next two None: as calibrated. 2.75, 2.25 and (1.2, 1, 1.05) are
            the publication's, of the camera of RealX3D.
        gamma: Of the power 1 / gamma.
        balance: Of red, green and blue after it.
        blur: Standard deviation of the smoothing of targets, px, as published.
        dark_weight: Share of the loss against the dark pictures, once it has grown, as published.
        growing: Share of the iterations over which it grows from 0: 3,000 of 15,000 as published.
    """

    gain: float | None = None
    gamma: float | None = None
    balance: tuple[float, float, float] | None = None
    blur: float = 1.0
    dark_weight: float = 0.5
    growing: float = 0.2

    def __post_init__(self) -> None:
        for name in ("gain", "gamma"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ValueError(f"{name} must be > 0, got {value}")
        if self.balance is not None and not all(factor > 0 for factor in self.balance):
            raise ValueError(f"balance must be three factors > 0, got {self.balance}")
        if not self.blur >= 0:
            raise ValueError(f"blur must be >= 0 px, got {self.blur}")
        if not (0 <= self.dark_weight <= 1 and 0 <= self.growing <= 1):
            raise ValueError(f"dark_weight and growing must lie in 0..1, got {self.dark_weight} and {self.growing}")
