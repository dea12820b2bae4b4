"""LL-Gaussian: reflectance, illumination and interference of Gaussians (`ll_gaussian.py`)."""

from dataclasses import dataclass

from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.rivals.row import rival
from novags.splats.training.config import FitConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class LlGaussianConfig:
    """All choices.

    Attributes:
        pictures: Which pictures it sees.
        fit: Of the Gaussians; `fit.dssim_weight` is w.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        smooth_weight: Of the slopes of the illumination.
        bright_weight: Of the illumination against the brightest channel.
        sparse_weight: Of the interference.
        target: Mean of the lit training views, sRGB code.
    """

    pictures: Pictures = "8bit"
    fit: FitConfig = ORIGINAL_FIT
    init_scale: float = ORIGINAL_SCALE
    smooth_weight: float = 0.1
    bright_weight: float = 0.1
    sparse_weight: float = 0.1
    target: float = 0.5

    def __post_init__(self) -> None:
        weights = self.smooth_weight, self.bright_weight, self.sparse_weight
        if min(weights) < 0:
            raise ValueError(f"weights must be >= 0, got {weights}")
        if not 0 < self.target < 1:
            raise ValueError(f"target must lie in (0, 1), got {self.target}")


METHOD = rival(
    LlGaussianConfig,
    Later("novags.methods.rivals.ll_gaussian:train"),
    title="reflectance, illumination and interference of each Gaussian; shown with the illumination raised",
    color="#9c755f",
    source="the decomposition of LL-Gaussian (Sun et al. 2025)",
    memory=Memory(fixed=0.55e9, pictures=1.0, work=130.0),
)
