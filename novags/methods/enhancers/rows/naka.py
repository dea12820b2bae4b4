"""The tone mapping of Naka-GS as a row: see `curves/naka.py`."""

import math
from dataclasses import dataclass

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class NakaConfig(EnhancerConfig):
    """Naka and Rushton's response y = x / (x + half), stretched to 0..1 by the least and largest y of the picture."""

    half: float = 0.05  # code that becomes one half before the stretch, as published

    def __post_init__(self) -> None:
        if not 0 < self.half < math.inf:
            raise ValueError(f"half must be > 0 and finite, got {self.half}")


ENHANCER = Enhancer(
    NakaConfig,
    Later("novags.methods.enhancers.curves.naka:naka"),
    Later("novags.methods.enhancers.curves.curve:mean_params"),
    title="a saturating response, stretched to the picture's range (Naka and Rushton 1966)",
)
METHOD = by_enhancer(
    NakaConfig(),
    "raise each picture by Naka and Rushton's response, without the network that corrects it",
    "#7a4f6d",
    "Naka-GS (arXiv 2604.11142), of which the correction network and the point densification are left out",
)
