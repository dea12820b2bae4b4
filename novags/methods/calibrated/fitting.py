"""The fit that the branches of 3DGS4LL share: Gaussians of lit colours to pseudo-targets."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

from torch import Tensor

from novags.methods.calibrated.camera_model import read_calibration
from novags.methods.calibrated.config import CalibratedConfig
from novags.methods.enhanced.gaussian_fit import fit_for, reconstructed
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction
from novags.methods.start import start_gaussians
from novags.splats.training.fit import fit
from novags.splats.training.step import Step


def fitted(
    problem: Problem, config: CalibratedConfig, dark: Tensor, targets: Tensor,
    loss: Callable[[Step, Tensor], Tensor] | None, started: float, progress: Progress | None, checkpoint: Path | None,
) -> Reconstruction:  # fmt: skip
    """Gaussians of lit colours, fitted to targets [C, H, W, 3], by a loss of their own or the loss of 3DGS."""
    config = dataclasses.replace(config, fit=fit_for(problem, config.fit))
    start = start_gaussians(problem.start, dark, targets, sh_degree=config.fit.sh_degree, init_scale=config.init_scale)
    result = fit(
        start, problem.views, lambda i: targets[i], config.fit, photometric=loss, progress=progress,
        checkpoint=checkpoint,
    )  # fmt: skip
    scene = GaussianScene.of(result.gaussians, config.fit)
    found = {"calibrated_on": read_calibration(config.calibration).made}
    return reconstructed(
        result, config, scene, "lit", started, targets=targets, found=found, along=scene.along(result.kept)
    )
