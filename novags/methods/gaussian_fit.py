"""Enhanced pictures in, Gaussians out: the part that all methods with fixed target pictures share."""

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import Tensor

from novags.methods.enhancers import EnhancerConfig, enhancement_record
from novags.methods.enhancers.guided import EnhanceConfig
from novags.methods.problem import Pictures, Problem
from novags.methods.reconstruction import GaussianScene, Reconstruction, Scene, Space
from novags.methods.start import start_gaussians
from novags.splats import FitConfig, LearningRates, McmcConfig
from novags.splats.training.fit import FitResult, fit

Progress = Callable[[int, int, dict[str, float]], None]

# What 3DGS-MCMC itself does: the rate of the means falls over 30,000 iterations however long the run is, and Gaussians
# move until iteration 25,000.
ORIGINAL_FIT = FitConfig(rates=LearningRates(schedule="original"), mcmc=McmcConfig(refine_stop=25_000))
ORIGINAL_SCALE = 0.1  # of an initial Gaussian, in distances to its nearest neighbours


@dataclass(frozen=True, kw_only=True)
class EnhancedFitConfig:
    """Which pictures, how they are enhanced, how Gaussians are fitted to them."""

    pictures: Pictures = "8bit"
    enhance: EnhancerConfig = field(default_factory=EnhanceConfig)
    init_scale: float = ORIGINAL_SCALE
    fit: FitConfig = ORIGINAL_FIT


def fit_parts(config: EnhancedFitConfig) -> dict[str, int]:
    """`Method.parts`: the fit alone."""
    return {"fit": config.fit.iterations}


def fit_for(problem: Problem, config: FitConfig) -> FitConfig:
    """The configuration with the seed and the extent of the problem, and room for the Gaussians that it asks for.

    Where fewer points came than that, and the configuration names no cap, the population grows to the number.
    """
    cap, wanted = config.cap_max, problem.n_gaussians
    if cap is None and wanted is not None and wanted > len(problem.start.points):
        cap = wanted
    return dataclasses.replace(config, seed=problem.seed, extent=problem.start.extent, cap_max=cap)


def reconstructed(
    result: FitResult, config: Any, scene: Scene, space: Space, started: float, **more: Any
) -> Reconstruction:
    """The reconstruction of a method that consists of one fit.

    Args:
        result: Of the fit.
        config: The method's, with the `fit` that was done.
        scene: What the fit has trained, as it is shown.
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
    enhance: Callable[[Problem, EnhancerConfig, Pictures], Tensor],
    progress: Progress | None,
    checkpoint: Path | None,
) -> Reconstruction:
    """Fit Gaussians to the pictures that `enhance` returns for the problem.

    Args:
        problem: The problem; its seed and extent override those of `config.fit`.
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
    return Reconstruction(
        scene=GaussianScene.of(result.gaussians, config.fit),
        space="enhanced",
        config=config,
        enhancement=enhancement_record(config.enhance, config.pictures),
        enhanced=images,
        targets=images,
        viewmats=None if config.fit.refine_cameras is None else result.viewmats,
        losses=result.losses,
        seconds={"enhance": seconds, "fit": result.seconds},
    )
