"""Enhanced pictures in, Gaussians out: the part that all methods with fixed target pictures share."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch import Tensor

from novags.methods.enhanced.config import EnhancedFitConfig
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.choice import Enhancement
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.inputs import Pictures
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, ReconstructedScene, Reconstruction, Space
from novags.methods.start import start_gaussians
from novags.splats.training.config import FitConfig
from novags.splats.training.fit import FitResult, fit


def fit_for(problem: Problem, config: FitConfig) -> FitConfig:
    """The configuration with the seed and the extent of the problem, and room for the Gaussians that it asks for.

    Where fewer points came than that, and the configuration names no cap, the population grows to the number.
    """
    cap, wanted = config.cap_max, problem.n_gaussians
    if cap is None and wanted is not None and wanted > len(problem.start.points):
        cap = wanted
    return dataclasses.replace(config, seed=problem.seed, extent=problem.start.extent, cap_max=cap)


def reconstructed(
    result: FitResult, config: Any, scene: ReconstructedScene, space: Space, started: float, **more: Any
) -> Reconstruction:
    """The reconstruction of a method that consists of one fit.

    Args:
        result: Of the fit.
        config: The method's, with the `fit` that was done.
        scene: The trained scene, as shown.
        space: As in `Reconstruction`.
        started: `time.perf_counter()` at the beginning of the method.
        more: Further attributes of the `Reconstruction`.
    """
    other = time.perf_counter() - started - (result.seconds - result.earlier)
    return Reconstruction(
        scene=scene,
        space=space,
        config=config,
        viewmats=None if config.fit.refine_cameras is None else result.viewmats,
        losses=result.losses,
        seconds={"fit": result.seconds, "other": other},
        **more,
    )


def fit_enhanced(
    problem: Problem,
    config: EnhancedFitConfig,
    enhance: Callable[[Problem, Enhancement, Pictures], Tensor],
    progress: Progress | None,
    checkpoint: Path | None,
) -> Reconstruction:
    """Fit Gaussians to the pictures that `enhance` returns for the problem.

    Args:
        problem: The problem; its seed and extent override `config.fit`.
        config: All choices.
        enhance: (problem, configuration, pictures) -> [C, H, W, 3].
        progress: As in `splats.fit`.
        checkpoint: As in `splats.fit`.

    Returns:
        A reconstruction whose targets are the enhanced pictures. Seconds: "enhance" and "fit".
    """
    config = dataclasses.replace(config, fit=fit_for(problem, config.fit))
    started = time.perf_counter()
    images = enhance(problem, config.enhance, config.pictures)
    seconds = time.perf_counter() - started
    dark = problem.encoded(config.pictures)
    start = start_gaussians(problem.start, dark, images, sh_degree=config.fit.sh_degree, init_scale=config.init_scale)
    result = fit(start, problem.views, lambda i: images[i], config.fit, progress=progress, checkpoint=checkpoint)
    scene = GaussianScene.of(result.gaussians, config.fit)
    return Reconstruction(
        scene=scene,
        along=scene.along(result.kept),
        space="enhanced",
        config=config,
        enhancement=enhancement_record(config.enhance, config.pictures),
        enhanced=images,
        targets=images,
        viewmats=None if config.fit.refine_cameras is None else result.viewmats,
        losses=result.losses,
        seconds={"enhance": seconds, "fit": result.seconds},
    )
