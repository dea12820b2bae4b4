"""The ceiling of fields: fit the noise-free dark exposures, enhanced exactly as their noisy twins."""

from pathlib import Path

from novags.methods.enhancers.applying import enhanced_clean
from novags.methods.nerf.config import NerfConfig
from novags.methods.nerf.fitting import fit_enhanced_field
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction


def train(
    problem: Problem, config: NerfConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct from exposures that no real method can see; see `fit_enhanced_field`.

    Raises:
        LacksInput: If the problem has no noise-free exposures.
    """
    return fit_enhanced_field(problem, config, enhanced_clean, progress, checkpoint)
