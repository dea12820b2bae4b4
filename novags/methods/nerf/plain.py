"""Enhance every view, then fit a radiance field to the result, noise and all: `naive` with the other engine.

Mildenhall et al. 2020 (NeRF) with the encoding of Mueller et al. 2022 (Instant-NGP); novags.fields differs
from it.
"""

from pathlib import Path

from novags.methods.enhancers.applying import enhanced
from novags.methods.nerf.config import NerfConfig
from novags.methods.nerf.fitting import fit_enhanced_field
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction


def train(
    problem: Problem, config: NerfConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct from the enhanced noisy pictures; see `fit_enhanced_field`."""
    return fit_enhanced_field(problem, config, enhanced, progress, checkpoint)
