"""A power law of the codes as a row: see `curves/gamma.py`."""

import math
from dataclasses import dataclass

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.checks import check_target
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class GammaConfig(EnhancerConfig):
    """A power law of the codes."""

    gamma: float | None = 0.2  # None: the exponent that brings the mean code to `target`
    target: float = 0.5

    def __post_init__(self) -> None:
        check_target(self.target)
        if self.gamma is not None and not 0 < self.gamma < math.inf:
            raise ValueError(f"gamma must be > 0 and finite, got {self.gamma}")


ENHANCER = Enhancer(
    GammaConfig,
    Later("novags.methods.enhancers.curves.gamma:gamma"),
    Later("novags.methods.enhancers.curves.gamma:mean_params"),
    title="a power law of the codes",
)
METHOD = by_enhancer(
    GammaConfig(),
    "raise every code to the power 0.2",
    "#b8860b",
    "section 5 of the NOVA-GS paper, which names the exponent",
)
