"""Luminance-GS: dark and lit colours for each Gaussian (`luminance_gs.py`)."""

from dataclasses import dataclass

from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.rivals.row import rival
from novags.splats.training.config import FitConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class LuminanceGsConfig:
    """All choices; the defaults are the publication's.

    Attributes:
        pictures: Which pictures it sees.
        fit: Of the Gaussians; `fit.dssim_weight` is w.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        contrast: Local contrasts of the lit render, as a share of the contrasts of the dark picture brought to a mean
            of 1.
        lit_weight: Of the lit render against the brightened picture.
        contrast_weight: Of the contrasts.
        histogram_weight: Of the terms that shape the curve.
        curve_rate: Learning rate of the curve that all views share.
        attention_rate: Of the attention layers.
        axes_rate: Of the axes of colour.
        seen: Longest side of the pictures that the attention layers see, px.
    """

    pictures: Pictures = "8bit"
    fit: FitConfig = ORIGINAL_FIT
    init_scale: float = ORIGINAL_SCALE
    contrast: float = 0.5
    lit_weight: float = 0.5
    contrast_weight: float = 1.0
    histogram_weight: float = 10.0
    curve_rate: float = 1e-3
    attention_rate: float = 1e-5
    axes_rate: float = 2e-4
    seen: int = 64

    def __post_init__(self) -> None:
        weights = (self.contrast, self.lit_weight, self.contrast_weight, self.histogram_weight)
        if min(*weights, self.curve_rate, self.attention_rate, self.axes_rate) < 0:
            raise ValueError(f"contrast, weights and rates must be >= 0, got {self}")
        if self.seen < 8:
            raise ValueError(f"seen must be >= 8 px, got {self.seen}")


METHOD = rival(
    LuminanceGsConfig,
    Later("novags.methods.rivals.luminance_gs:train"),
    title="dark and lit colours for each Gaussian; the lit ones follow curves that are learned with them",
    color="#66a61e",
    source="Luminance-GS (Cui et al. 2025)",
    memory=Memory(fixed=0.66e9, pictures=2.0, work=61.0),
)
