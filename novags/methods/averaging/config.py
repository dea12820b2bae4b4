"""Settings of the average over views."""

from dataclasses import dataclass, field
from typing import Literal

from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures

Kernel = Literal["cubic", "linear"]


@dataclass(frozen=True, kw_only=True)
class AveragingConfig:
    """The exposures to average, and when a view counts as seeing a pixel.

    The surface is taken to look the same from everywhere: shiny things and mirrors are averaged all the same, and costs
    the noise-free average too.
    """

    exposures: Literal["noisy", "noise-free"] = "noisy"
    pictures: Pictures = "8bit"  # through whose enhancement the average goes; averaged are linear 16-bit ones
    enhance: Enhancement = field(default_factory=EnhanceConfig)
    kernel: Kernel = "cubic"
    tolerance: float = 0.01  # relative difference of depth up to which two views see the same surface
    coarsest: float = 3.0  # pixels of the view along one of a training view, up to which that is used

    def __post_init__(self) -> None:
        for name, value in (("exposures", ("noisy", "noise-free")), ("kernel", ("cubic", "linear"))):
            if getattr(self, name) not in value:
                raise ValueError(f"{name} must be one of {', '.join(value)}, got {getattr(self, name)!r}")
        if not 0 < self.tolerance < 1:
            raise ValueError(f"tolerance must lie in (0, 1), got {self.tolerance}")
        if not self.coarsest >= 1:
            raise ValueError(f"coarsest must be >= 1 pixel, got {self.coarsest}")
