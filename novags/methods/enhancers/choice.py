"""Values of a method's setting `enhance`, and its default, the configuration of the paper's enhancement.

Every method imports this file: it names no code of an enhancer, not even `guided.py`.
"""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from novags.methods.enhancers.enhancer import EnhancerConfig

Guide = Literal["channel", "luminance"]
NoiseEstimator = Literal["patch-pca", "immerkaer", "camera"]


@dataclass(frozen=True, kw_only=True)
class EnhanceConfig(EnhancerConfig):
    """Choices of the enhancement. The paper fixes `window` and `target` and leaves the rest open."""

    # "channel": a brightness map for each colour channel. "luminance": one for all, which keeps the ratios of the
    # channels, and averages their noise.
    guide: Guide = "channel"
    window: int = 33  # px, odd; shrunk to fit images smaller than it
    target: float = 0.5  # tau, mean of L**gamma
    eta: float = 1e-4  # in R = L**gamma / (L + eta)
    # "camera" takes the known noise of the camera, for pictures whose noise is not white, as after demosaicing.
    noise_estimator: NoiseEstimator = "patch-pca"
    noise_factor: float = 1.0  # epsilon = noise_factor * estimated noise variance
    gamma_min: float = 0.02
    gamma_max: float = 5.0
    bisection_steps: int = 40

    def __post_init__(self) -> None:
        if self.window < 1 or self.window % 2 == 0:
            raise ValueError(f"window must be odd and >= 1 px, got {self.window}")
        if not 0 < self.target < 1:
            raise ValueError(f"target must lie in (0, 1), got {self.target}")
        if not self.eta > 0:
            raise ValueError(f"eta must be > 0 (black pixels would be divided by zero), got {self.eta}")
        for name, known in (("guide", get_args(Guide)), ("noise_estimator", get_args(NoiseEstimator))):
            if (value := getattr(self, name)) not in known:
                raise ValueError(f"{name} must be one of {', '.join(known)}, got {value!r}")
        if not 0 <= self.noise_factor < math.inf:
            raise ValueError(f"noise_factor must be finite and >= 0, got {self.noise_factor}")
        if not 0 < self.gamma_min < self.gamma_max:
            raise ValueError(f"need 0 < gamma_min < gamma_max, got {self.gamma_min} and {self.gamma_max}")


# Any enhancer's configuration; "default" means the first of these types.
Enhancement: TypeAlias = EnhanceConfig | EnhancerConfig | None
