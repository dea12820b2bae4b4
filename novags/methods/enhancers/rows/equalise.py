"""Histogram equalisation as a row: see `curves/equalise.py`."""

from dataclasses import dataclass

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class EqualiseConfig(EnhancerConfig):
    """Histogram equalisation of the luma; it has no settings."""


ENHANCER = Enhancer(
    EqualiseConfig,
    Later("novags.methods.enhancers.curves.equalise:equalise"),
    Later("novags.methods.enhancers.curves.equalise:mean_curve"),
    title="histogram equalisation of the luma",
)
METHOD = by_enhancer(
    EqualiseConfig(),
    "equalise the histogram of each picture's luma",
    "#cd853f",
    "histogram equalisation (Gonzalez and Woods, Digital Image Processing)",
)
