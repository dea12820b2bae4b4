"""LE3D: Gaussians in linear light, coloured by a network, that stand close together along each ray (`le3d`)."""

import math
from dataclasses import dataclass, field, replace

from novags.methods.enhanced.config import ORIGINAL_SCALE
from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.rivals.row import rival
from novags.splats.training.config import FitConfig, LearningRates, McmcConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class ColourRates(LearningRates):
    """Rates of 3DGS, and of LE3D's colours.

    Attributes:
        sh_dc: Of b.
        features: Of f.
        colours_final: Of b, f and the network at the end of the run, to which they fall by half a cosine.
    """

    schedule: str = "original"
    sh_dc: float = 2e-3
    features: float = 1e-4
    colours_final: float = 1e-5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.colours_final >= 0:
            raise ValueError(f"learning rate colours_final must be >= 0, got {self.colours_final}")

    def at(self, iteration: int, iterations: int) -> LearningRates:
        """As for all fits, with b and f on their own way."""
        b, f = (self.falling(rate, iteration, iterations) for rate in (self.sh_dc, self.features))
        return replace(super().at(iteration, iterations), sh_dc=b, features=f)

    def falling(self, rate: float, iteration: int, iterations: int) -> float:
        """A rate at an iteration on its way to `colours_final`."""
        left = (1 + math.cos(math.pi * iteration / max(1, iterations))) / 2
        return self.colours_final + (rate - self.colours_final) * left


@dataclass(frozen=True, kw_only=True)
class Le3dConfig:
    """All choices; the defaults are the publication's, but for `seen` and `ends`.

    Attributes:
        fit: Of the Gaussians; `fit.dssim_weight` and `fit.sh_degree` have no effect.
        epsilon: Of the loss, in units of white. Without it the darkest pixels, where noise is all there is, would weigh
            without bound.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        init_opacity: Of an initial Gaussian.
        scatter: Points in the cone for each first point; 0: none.
        network_rate: Learning rate of the network of colours, which falls to `fit.rates.colours_final`.
        opaque_weight: Of R_T.
        spread_weight: Of R_dist.
        near_far_weight: Of R_nf.
        seen: Longest side of the picture that R_dist and R_nf are taken from, px; larger ones are rendered smaller.
        ends: M, how many Gaussians at each end of a ray R_nf takes.
        pictures: Through whose enhancement the result is shown, and compared with methods that enhance.
        enhance: That enhancement.
    """

    fit: FitConfig = FitConfig(rates=ColourRates(), mcmc=McmcConfig(refine_stop=25_000), sh_degree=0)
    epsilon: float = 1e-3
    init_scale: float = ORIGINAL_SCALE
    init_opacity: float = 0.1
    scatter: float = 5.0
    network_rate: float = 1e-4
    opaque_weight: float = 0.01
    spread_weight: float = 0.1
    near_far_weight: float = 0.01
    seen: int = 64
    ends: int = 1
    pictures: Pictures = "8bit"
    enhance: Enhancement = field(default_factory=EnhanceConfig)

    def __post_init__(self) -> None:
        if not self.epsilon > 0:
            raise ValueError(f"epsilon must be > 0 (black renders would be divided by zero), got {self.epsilon}")
        weights = self.opaque_weight, self.spread_weight, self.near_far_weight
        if not min(*weights, self.network_rate, self.scatter) >= 0:
            raise ValueError(f"weights, network_rate and scatter must be >= 0, got {self}")
        if not 0 < self.init_opacity < 1:
            raise ValueError(f"init_opacity must lie in (0, 1), got {self.init_opacity}")
        if self.seen < 8 or self.ends < 1:
            raise ValueError(f"seen must be >= 8 px and ends >= 1, got {self.seen} and {self.ends}")


METHOD = rival(
    Le3dConfig,
    Later("novags.methods.rivals.le3d.trainer:train"),
    title="the light of the scene, in colours from a network, fitted to the raw data by the loss of RawNeRF with "
    "Gaussians close together along each ray",
    color="#c2185b",
    source="LE3D (Jin et al. 2024)",
    memory=Memory(gaussian=4000.0, pictures=2.8, work=60.0),  # thirty-two channels of each Gaussian
)
