"""Settings of all methods with a fit of Gaussians to enhanced pictures."""

from dataclasses import dataclass, field

from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures
from novags.splats.training.config import FitConfig, LearningRates, McmcConfig

# The schedule of 3DGS-MCMC itself: the rate of the means falls over 30,000 iterations however long the run is, and
# Gaussians move until iteration 25,000.
ORIGINAL_FIT = FitConfig(rates=LearningRates(schedule="original"), mcmc=McmcConfig(refine_stop=25_000))


ORIGINAL_SCALE = 0.1  # of an initial Gaussian, in distances to its nearest neighbours


@dataclass(frozen=True, kw_only=True)
class EnhancedFitConfig:
    """Which pictures, how they are enhanced, how Gaussians are fitted to them."""

    pictures: Pictures = "8bit"
    enhance: Enhancement = field(default_factory=EnhanceConfig)
    init_scale: float = ORIGINAL_SCALE
    fit: FitConfig = ORIGINAL_FIT


def fit_parts(config: EnhancedFitConfig) -> dict[str, int]:
    """`Method.parts`: the fit alone."""
    return {"fit": config.fit.iterations}
