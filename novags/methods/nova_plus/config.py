"""Settings of the method as a whole, and how many iterations each of its fits takes."""

from dataclasses import dataclass, field
from typing import Literal

from novags.methods.denoised.config import DenoiseConfig
from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures
from novags.splats.training.config import FitConfig, LearningRates, McmcConfig

# Several times the rates of 3DGS, for short fits, and cooled at the end.
FAST = LearningRates(means=4e-4, means_final=4e-6, quats=4e-3, log_scales=2e-2, sh_dc=2e-2, sh_rest=1e-3, cool_to=0.1)


MCMC = McmcConfig(refine_start=50, refine_every=50, growth=1.08, noise_lr=2e5)


# Opacities are regularised early in a stage, which keeps noise out of it, then freed, which makes surfaces dense.
FIT = FitConfig(rates=FAST, eps2d=0.1, mcmc=MCMC, opacity_reg_fall=1.0)


PIXELS_PER_GAUSSIAN = 11  # of all training views: more Gaussians gain little, fewer lose


PARTS = {"likelihood": 10, "structure": 10, "merged": 2, "plain": 24}  # each fit, in 24ths of `fit.iterations`


@dataclass(frozen=True, kw_only=True)
class NovaPlusConfig:
    """All choices. A setting of None follows a rule from the data.

    Attributes:
        fit: Of both stages, each from the first points. They take 10 24ths of `fit.iterations` each (`PARTS`), for each
            seed, and merging takes 2: in all 1.75 times as many for two seeds. `fit.opacity_reg` is the weight in stage
            2, and in stage 1 where every pixel measures all channels; merged sets have none.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        gaussians: How many each seed has; None: one for every `PIXELS_PER_GAUSSIAN` of all views, however many points
            there are at the start. `fit.cap_max`, where it is given, caps all seeds together.
        seeds: Independent reconstructions that are merged.
        held_share: Share of the pixels that is held out to judge; nothing is where neighbours share their noise.
        bandwidth: Of the guided averages, in tone; None: chosen by `choose_bandwidth`.
        averaged_share: Of the guided averages beside their guide, in the targets of stage 2.
        denoise: The trained denoiser, for data whose noise is independent; None: without it.
        denoised_share: Of its pictures in the targets of stage 2.
        least_share: Of both shares, which fall with the variance of what they are shares of; 1: they do not fall.
        plain: Whether held-out data may choose a plain fit, L1 to the data as they are, instead of the whole method.
        stages: How far to go: "likelihood" alone, or "all".
        noise: "camera": the known noise, where there is one; "pictures": estimated from the pictures.
        pictures: Whose enhancement the result is shown through, and compared with methods that enhance.
        enhance: That enhancement.
    """

    fit: FitConfig = FIT
    init_scale: float = 0.7
    gaussians: int | None = None
    seeds: int = 2
    held_share: float = 0.03
    bandwidth: float | None = None
    averaged_share: float = 1 / 2
    denoise: DenoiseConfig | None = field(default_factory=DenoiseConfig)
    denoised_share: float = 1 / 3
    least_share: float = 1.0
    plain: bool = False
    stages: Literal["likelihood", "all"] = "all"
    noise: Literal["camera", "pictures"] = "camera"
    pictures: Pictures = "8bit"
    enhance: Enhancement = field(default_factory=EnhanceConfig)

    def __post_init__(self) -> None:
        if self.seeds < 1:
            raise ValueError(f"seeds must be >= 1, got {self.seeds}")
        if not 0 <= self.held_share < 1:
            raise ValueError(f"held_share must lie in [0, 1), got {self.held_share}")
        shares = (self.averaged_share, self.denoised_share, self.least_share)
        if not all(0 <= share <= 1 for share in shares):
            raise ValueError(
                "averaged_share, denoised_share and least_share must lie in [0, 1], got {}, {} and {}".format(*shares)
            )
        if self.bandwidth is not None and not self.bandwidth > 0:
            raise ValueError(f"bandwidth must be > 0 or None, got {self.bandwidth}")
        if self.gaussians is not None and self.gaussians < 1:
            raise ValueError(f"gaussians must be >= 1 or None, got {self.gaussians}")

    def gaussians_each(self, pixels: float) -> int:
        """How many Gaussians each seed may have, of so many pixels of all views."""
        wanted = self.gaussians or max(1, int(pixels) // PIXELS_PER_GAUSSIAN)  # 0 for pictures of a few pixels
        cap = self.fit.cap_max
        return wanted if cap is None else min(wanted, max(1, cap // self.seeds))

    def iterations(self, part: str) -> int:
        """How many one fit of a part takes; "merged" comes once."""
        return max(1, round(self.fit.iterations * PARTS[part] / 24))


def parts(config: NovaPlusConfig) -> dict[str, int]:
    """`Method.parts`: the fits of all seeds, stage by stage."""
    counts = {"likelihood": config.seeds * config.iterations("likelihood")}
    if config.stages == "all":
        adapt = None if config.denoise is None else config.denoise.adapt
        counts["denoiser"] = 0 if adapt is None else adapt.steps
        counts["structure"] = config.seeds * config.iterations("structure")
    if config.seeds > 1:
        counts["merged"] = config.iterations("merged")
    if config.plain:
        counts["plain"] = config.iterations("plain")
    return counts
