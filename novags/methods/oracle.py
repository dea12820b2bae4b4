"""The ceiling: fit the noise-free dark exposures, enhanced exactly as their noisy twins."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from novags.methods.enhanced_fit import EnhancedFitConfig
from novags.methods.enhancers import enhanced_clean
from novags.methods.gaussian_fit import Progress, fit_enhanced
from novags.methods.problem import Problem
from novags.methods.reconstruction import Reconstruction


@dataclass(frozen=True, kw_only=True)
class OracleConfig(EnhancedFitConfig):
    """How the noise-free exposures are enhanced and fitted."""

    demosaiced: bool = False  # behind a colour filter array: learn from interpolated mosaics, errors of that included


def train(
    problem: Problem, config: OracleConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct from exposures that no real method can see; see `fit_enhanced`.

    Raises:
        LacksInput: If the problem has no noise-free exposures.
    """
    return fit_enhanced(problem, config, partial(enhanced_clean, demosaiced=config.demosaiced), progress, checkpoint)
