"""The ceiling: fit the noise-free dark exposures, enhanced exactly as their noisy twins."""

from functools import partial
from pathlib import Path

from novags.methods.enhanced.gaussian_fit import fit_enhanced
from novags.methods.enhanced.oracle import OracleConfig
from novags.methods.enhancers.applying import enhanced_clean
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction


def train(
    problem: Problem, config: OracleConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct from exposures that no real method can see; see `fit_enhanced`.

    Raises:
        LacksInput: If the problem has no noise-free exposures.
    """
    return fit_enhanced(problem, config, partial(enhanced_clean, demosaiced=config.demosaiced), progress, checkpoint)
