"""Gaussians in linear light, fitted to raw data (`raw_gs.py`)."""

from dataclasses import dataclass, field

from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE
from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.rivals.row import rival
from novags.splats.training.config import FitConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class RawGsConfig:
    """All choices.

    Attributes:
        fit: Of the Gaussians; `fit.dssim_weight` has no effect.
        epsilon: Of the loss, in units of white. Without it the darkest pixels, where noise is all there is, would weigh
            without bound.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        pictures: Through whose enhancement the result is shown, and compared with methods that enhance.
        enhance: That enhancement.
    """

    fit: FitConfig = ORIGINAL_FIT
    epsilon: float = 1e-3
    init_scale: float = ORIGINAL_SCALE
    pictures: Pictures = "8bit"
    enhance: Enhancement = field(default_factory=EnhanceConfig)

    def __post_init__(self) -> None:
        if not self.epsilon > 0:
            raise ValueError(f"epsilon must be > 0 (black renders would be divided by zero), got {self.epsilon}")


METHOD = rival(
    RawGsConfig,
    Later("novags.methods.rivals.raw_gs:train"),
    title="the light of the scene, fitted to the raw data by the loss of RawNeRF",
    color="#a6761d",
    source="RawNeRF (Mildenhall et al. 2022) and LE3D (Jin et al. 2024)",
    memory=Memory(pictures=5.0, work=80.0),
)
