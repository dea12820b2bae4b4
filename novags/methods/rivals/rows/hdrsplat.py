"""HDRSplat: Gaussians in linear light, fitted to denoised raw data (`hdrsplat.py`)."""

from dataclasses import dataclass

from novags.methods.denoised.config import DenoisedConfig, parts
from novags.methods.memory import Memory
from novags.methods.rivals.row import rival
from novags.splats.training.config import FitConfig, LearningRates, McmcConfig
from sensor_model.files.registry import Later

# Lower rates than in 3DGS, for colours in units of white, as published: of the position at the start, the scales, the
# opacity and the colour. Higher harmonics have a twentieth, as in 3DGS, and the position ends at its rate there.
TUNED_FIT = FitConfig(
    rates=LearningRates(
        schedule="original", means=8e-5, log_scales=1e-3, logit_opacities=5e-3, sh_dc=5e-4, sh_rest=2.5e-5
    ),
    mcmc=McmcConfig(refine_stop=25_000),
)


@dataclass(frozen=True, kw_only=True)
class HdrsplatConfig(DenoisedConfig):
    """All choices.

    Attributes:
        pictures: Through whose enhancement the result is shown, and compared with methods that enhance.
        enhance: That enhancement.
        denoise: How the raw data are denoised.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        fit: Of the Gaussians; `fit.dssim_weight` is w.
        epsilon: Of the loss, in units of white. Without it, black renders would be divided by zero.
        least_bright: The light that bright pixels have at least, in units of white: darker captures are amplified to
            it. Without it, a step of the learning rate of colours is larger than all light of such a capture.
    """

    fit: FitConfig = TUNED_FIT
    epsilon: float = 1e-3
    least_bright: float = 0.02

    def __post_init__(self) -> None:
        if not self.epsilon > 0:
            raise ValueError(f"epsilon must be > 0 (black renders would be divided by zero), got {self.epsilon}")
        if not 0 < self.least_bright <= 1:
            raise ValueError(f"least_bright must lie in (0, 1], got {self.least_bright}")


METHOD = rival(
    HdrsplatConfig,
    Later("novags.methods.rivals.hdrsplat:train"),
    title="the light of the scene, fitted to denoised raw data by relative distances and SSIM in linear light",
    color="#b3446c",
    source="HDRSplat (Singh et al. 2024)",
    memory=Memory(fixed=0.6e9, pictures=4.0, work=100.0),
    parts=parts,
)
