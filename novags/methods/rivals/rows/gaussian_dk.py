"""Gaussian-DK: radiance, and a learned camera response (`gaussian_dk.py`)."""

from dataclasses import dataclass

from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.rivals.row import rival
from novags.splats.training.config import FitConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class GaussianDkConfig:
    """All choices.

    Attributes:
        pictures: Which pictures it sees.
        fit: Of the Gaussians; `fit.dssim_weight` is w.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        response_rate: Learning rate of the response.
        target: Mean of the lit training views, sRGB code.
    """

    pictures: Pictures = "8bit"
    fit: FitConfig = ORIGINAL_FIT
    init_scale: float = ORIGINAL_SCALE
    response_rate: float = 5e-4
    target: float = 0.5

    def __post_init__(self) -> None:
        if not 0 < self.target < 1:
            raise ValueError(f"target must lie in (0, 1), got {self.target}")
        if not self.response_rate >= 0:
            raise ValueError(f"response_rate must be >= 0, got {self.response_rate}")


METHOD = rival(
    GaussianDkConfig,
    Later("novags.methods.rivals.gaussian_dk:train"),
    title="radiance, and a camera response that is learned with it; shown at a larger exposure",
    color="#b07aa1",
    source="Gaussian-DK (Ye et al. 2024)",
    memory=Memory(fixed=0.58e9, pictures=3.0, work=150.0),
)
