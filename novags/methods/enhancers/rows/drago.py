"""Drago's adaptive logarithm as a row: see `curves/drago.py`."""

from dataclasses import dataclass

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class DragoConfig(EnhancerConfig):
    """Adaptive logarithmic mapping (Drago, Myszkowski, Annen, Chiba 2003)."""

    bias: float = 0.85  # b; the paper recommends 0.7 to 0.9 and uses 0.85

    def __post_init__(self) -> None:
        if not 0 < self.bias < 1:
            raise ValueError(f"bias must lie in (0, 1), got {self.bias}")


ENHANCER = Enhancer(
    DragoConfig,
    Later("novags.methods.enhancers.curves.drago:drago"),
    Later("novags.methods.enhancers.curves.curve:geometric_mean_params"),
    title="adaptive logarithm (Drago, Myszkowski, Annen, Chiba 2003)",
)
METHOD = by_enhancer(
    DragoConfig(),
    "map the luminance of each picture by an adaptive logarithm",
    "#8b6f47",
    "Adaptive Logarithmic Mapping For Displaying High Contrast Scenes (Drago et al. 2003)",
)
