"""A longer exposure as a row: see `curves/gain.py`."""

from dataclasses import dataclass

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.checks import check_target
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class GainConfig(EnhancerConfig):
    """A factor on the linear light, as a longer exposure would give; light above white is clipped."""

    target: float = 0.5  # mean code

    def __post_init__(self) -> None:
        check_target(self.target)


ENHANCER = Enhancer(
    GainConfig,
    Later("novags.methods.enhancers.curves.gain:gain"),
    Later("novags.methods.enhancers.curves.curve:geometric_mean_params"),
    title="a factor on the linear light, as a longer exposure gives",
)
METHOD = by_enhancer(
    GainConfig(),
    "multiply the light of each picture until its mean code is 0.5",
    "#a0522d",
    "a longer exposure, as far as a factor can replace it",
)
