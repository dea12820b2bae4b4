"""Enhance every view, then fit Gaussians to the result, noise and all."""

from pathlib import Path

from novags.methods.enhancers import enhanced
from novags.methods.gaussian_fit import EnhancedFitConfig, Progress, fit_enhanced
from novags.methods.problem import Problem
from novags.methods.reconstruction import Reconstruction


def train(
    problem: Problem, config: EnhancedFitConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct from the enhanced noisy pictures; see `fit_enhanced`."""
    return fit_enhanced(problem, config, enhanced, progress, checkpoint)
