"""Settings of NOVA-GS as a whole; the defaults are the paper's."""

from dataclasses import dataclass, field
from typing import Literal

from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE
from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures
from novags.methods.nova.denoiser_config import DenoiserConfig
from novags.splats.training.config import FitConfig


@dataclass(frozen=True, kw_only=True)
class ConsistencyConfig:
    """Choices of the geometric loss; the paper fixes `occlusion_tolerance` and the network."""

    weight: float = 1.0  # of L_geo in the total loss
    confidence_weight: float = 0.05  # lambda_c; C saturates at 1 where it exceeds the residual
    start: float = 0.25  # of the iterations, when depths become meaningful
    every: int = 1  # iterations between two evaluations, each weighted `every` times; one costs a second rendering
    occlusion_tolerance: float = 0.1  # relative depth difference
    min_alpha: float = 0.5  # pixels the Gaussians cover less have no depth
    # Which views may be the source of a target view: the views with the nearest centres, the views whose optical axes
    # differ least, or all within the limits below. The paper does not say.
    pairs: Literal["nearest", "angle", "random"] = "nearest"
    neighbours: int = 8  # candidates per view, at most; "random" has no such limit
    max_angle: float = 30.0  # degrees between optical axes
    min_distance: float = 0.002  # between camera centres, in scene extents: closer ones carry no parallax
    max_distance: float = 1.5  # same unit
    # The pictures warped from the source and compared with their counterparts in the target: pseudo-clean pictures,
    # noisy enhanced ones, or renderings. The source's rendering is a constant, like its depth; the target's is not.
    warped: Literal["clean", "enhanced", "render"] = "clean"
    confidence: bool = True  # False: C = 1, and so no L_conf
    learning_rate: float = 1e-3  # Adam, confidence network

    def __post_init__(self) -> None:
        if self.weight < 0 or self.confidence_weight < 0:
            raise ValueError(f"weights must be >= 0, got {self.weight} and {self.confidence_weight}")
        if not 0 <= self.start <= 1:
            raise ValueError(f"start must lie in [0, 1], got {self.start}")
        if self.every < 1 or self.neighbours < 1:
            raise ValueError(f"every and neighbours must be >= 1, got {self.every} and {self.neighbours}")
        if not self.occlusion_tolerance > 0:
            raise ValueError(f"occlusion_tolerance must be > 0, got {self.occlusion_tolerance}")


@dataclass(frozen=True, kw_only=True)
class NovaConfig:
    """The whole method; the defaults are the paper's. `fit.dssim_weight` is its lambda.

    L_recon is the fit's own photometric loss.
    """

    pictures: Pictures = "8bit"
    enhance: Enhancement = field(default_factory=EnhanceConfig)
    denoiser: DenoiserConfig | None = field(default_factory=DenoiserConfig)  # None fits the enhanced pictures
    consistency: ConsistencyConfig | None = field(default_factory=ConsistencyConfig)  # None leaves L_geo out
    sh_weight: float | None = 1.0  # of L_SH; None leaves it out
    # "The masked loss serves as the sole optimization objective for the denoiser" (section 4.3.3). False lets L_recon
    # reach it too, which is how section 4.7 can be read ("jointly optimized in an end-to-end manner").
    detach_target: bool = True
    refresh_after: int = 1  # denoiser steps after which a view's pseudo-clean image is computed anew
    init_scale: float = ORIGINAL_SCALE
    fit: FitConfig = ORIGINAL_FIT

    def __post_init__(self) -> None:
        if self.sh_weight is not None and not self.sh_weight > 0:
            raise ValueError(f"sh_weight must be > 0, or None to leave L_SH out, got {self.sh_weight}")
        if self.refresh_after < 1:
            raise ValueError(f"refresh_after must be >= 1, got {self.refresh_after}")
        if self.denoiser is None and self.sh_weight is not None:
            raise ValueError(
                f"sh_weight = {self.sh_weight} has no effect without a denoiser, whose residual is the noise map: set "
                "sh_weight to None too"
            )
        if not self.detach_target and (self.denoiser is None or self.denoiser.denoise_every is None):
            raise ValueError(
                "detach_target = False has no effect where the denoiser does not train beside the fit: set "
                "denoiser.denoise_every, or leave detach_target True"
            )


def parts(config: NovaConfig) -> dict[str, int]:
    """`Method.parts`: warm-up of the denoiser, then the fit with the rest of its training."""
    warmup = 0 if config.denoiser is None else config.denoiser.warmup_steps
    return {"denoiser": warmup, "fit": config.fit.iterations}
