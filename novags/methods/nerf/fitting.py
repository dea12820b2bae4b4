"""Pictures in, a field out: the part that all methods with a field share."""

import dataclasses
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from novags.fields.box import box_of
from novags.fields.layout import FieldLayout
from novags.fields.training.anchors import PointLoss
from novags.fields.training.batch import Batch
from novags.fields.training.config import FieldFitConfig
from novags.fields.training.fit import FieldFit, fit_field
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.choice import Enhancement
from novags.methods.inputs import Pictures
from novags.methods.nerf.config import NerfConfig
from novags.methods.nerf.losses import robust
from novags.methods.nerf.scene import FieldScene
from novags.methods.nerf.shading import at, display
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction, Space
from novags.methods.start import brightened

RENDERED = 2  # samples of a picture's ray, for each that trained: a sample too few shows in every pixel


def with_outputs(fit: FieldFitConfig, problem: Problem, *, static: int, viewed: int) -> FieldFitConfig:
    """The configuration with the seed of the problem, and room for a method's outputs."""
    layout: FieldLayout = dataclasses.replace(fit.layout, static=static, viewed=viewed)
    return dataclasses.replace(fit, seed=problem.seed, layout=layout)


def fitted_scene(
    problem: Problem,
    loss: Callable[[Batch], Tensor],
    fit: FieldFitConfig,
    shading: str,
    *,
    numbers: Mapping[str, float] | None = None,
    at_points: PointLoss | None = None,
    extra: Mapping[str, Tensor] | None = None,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
) -> tuple[FieldScene, FieldFit]:
    """Fit a field to a problem; arguments as for `fit_field` and of the FieldScene. The problem is on the CPU."""
    points = problem.start.points.detach().cpu()
    box = box_of(problem.views.centers, points)
    found = fit_field(
        problem.views, points, box, loss, fit, at_points=at_points, extra=extra, progress=progress,
        checkpoint=checkpoint,
    )  # fmt: skip
    state = found.state
    return FieldScene(state.field, box, state.proposal, RENDERED * fit.samples, shading, dict(numbers or {})), found


def reconstructed(
    scene: FieldScene, fitted: FieldFit, config: Any, space: Space, started: float, **more: Any
) -> Reconstruction:
    """The reconstruction of a method that consists of one fit; as `gaussian_fit.reconstructed`."""
    other = time.perf_counter() - started - (fitted.seconds - fitted.earlier)
    seconds = {"fit": fitted.seconds, "other": other}
    return Reconstruction(scene=scene, space=space, config=config, losses=fitted.state.losses, seconds=seconds, **more)


def fit_enhanced_field(
    problem: Problem,
    config: NerfConfig,
    enhance: Callable[[Problem, Enhancement, Pictures], Tensor],
    progress: Progress | None,
    checkpoint: Path | None,
) -> Reconstruction:
    """Fit a field to the pictures that `enhance` returns for the problem, by the `robust` loss.

    Args:
        problem: The problem; its seed overrides `config.fit`.
        config: All choices.
        enhance: (problem, configuration, pictures) -> [C, H, W, 3].
        progress: As in `fit_field`.
        checkpoint: As in `fit_field`.

    Returns:
        A reconstruction whose targets are the enhanced pictures. Seconds: "enhance" and "fit".
    """
    config = dataclasses.replace(config, fit=with_outputs(config.fit, problem, static=0, viewed=3))
    started = time.perf_counter()
    images = enhance(problem, config.enhance, config.pictures).cpu()
    seconds = time.perf_counter() - started

    problem = problem.to("cpu")
    colors = brightened(problem.start.colors, problem.encoded(config.pictures), images)

    def shown(raw: Tensor, weights: Tensor) -> Tensor:
        return display(raw, weights, {})

    def loss(batch: Batch) -> Tensor:
        return robust(shown(batch.raw, batch.weights) - batch.of(images))

    def at_points(chosen: Tensor, raw: Tensor) -> Tensor:
        return robust(at(raw, shown) - colors[chosen])

    scene, found = fitted_scene(
        problem, loss, config.fit, "display", at_points=at_points, progress=progress, checkpoint=checkpoint
    )
    return Reconstruction(
        scene=scene,
        space="enhanced",
        config=config,
        enhancement=enhancement_record(config.enhance, config.pictures),
        enhanced=images,
        targets=images,
        losses=found.state.losses,
        seconds={"enhance": seconds, "fit": found.seconds},
    )
