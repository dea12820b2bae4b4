"""Settings of the denoising of raw data, and of the method that fits the denoised data."""

from dataclasses import dataclass, field

from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE
from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures
from novags.splats.training.config import FitConfig

TURNS = 8  # flips and quarter turns of a square


@dataclass(frozen=True, kw_only=True)
class AdaptConfig:
    """How a network is adapted to a capture."""

    steps: int = 120
    learning_rate: float = 5e-4  # Adam, falling to zero in half a cosine
    batch: int = 8  # crops per step
    crop: int = 64  # px, even
    strength: float = 0.5  # a

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch < 1:
            raise ValueError(f"need steps and batch >= 1, got {self.steps} and {self.batch}")
        if self.crop < 2 or self.crop % 2:
            raise ValueError(f"crop must be even and >= 2 px (a mosaic repeats every 2), got {self.crop}")
        if not self.learning_rate > 0 or not self.strength > 0:
            raise ValueError(f"learning_rate and strength must be > 0, got {self.learning_rate} and {self.strength}")


@dataclass(frozen=True, kw_only=True)
class DenoiseConfig:
    """How the pictures are denoised."""

    adapt: AdaptConfig | None = field(default_factory=AdaptConfig)  # to the capture; None: the network as shipped
    turns: int = TURNS  # flips and quarter turns whose estimates are averaged

    def __post_init__(self) -> None:
        if not 1 <= self.turns <= TURNS:
            raise ValueError(f"turns must be 1 to {TURNS}, got {self.turns}")


@dataclass(frozen=True, kw_only=True)
class DenoisedConfig:
    """Denoising, then enhancement and fit as in the method that fits the noisy pictures.

    The raw data are denoised, or linear pictures. The denoised pictures go through the enhancement of `pictures`, so
    that they are compared with the same reference as the noisy ones.
    """

    pictures: Pictures = "8bit"
    enhance: Enhancement = field(default_factory=EnhanceConfig)
    denoise: DenoiseConfig = field(default_factory=DenoiseConfig)
    init_scale: float = ORIGINAL_SCALE
    fit: FitConfig = ORIGINAL_FIT


def parts(config: DenoisedConfig) -> dict[str, int]:
    """`Method.parts`: adaptation of the network, then the fit."""
    adapting = 0 if config.denoise.adapt is None else config.denoise.adapt.steps
    return {"denoiser": adapting, "fit": config.fit.iterations}
