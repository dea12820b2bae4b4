"""The bound of counting statistics across views: the method `averaging`."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from torch import Tensor

from novags.methods.averaging.config import AveragingConfig
from novags.methods.averaging.scene import LEAST, AveragedScene, EachView
from novags.methods.averaging.surface import Array, SurfaceCamera
from novags.methods.averaging.warp import Rules
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.applying import enhanced_like, parameters_of_all
from novags.methods.inputs import LacksInput
from novags.methods.noise import Variance
from novags.methods.noise_estimate import noise_of
from novags.methods.problem import Problem, TrueSurface
from novags.methods.reconstruction import Reconstruction
from sensor_model.isp import srgb_to_linear


def train(
    problem: Problem,
    config: AveragingConfig,
    *,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
    checkpoint: Path | None = None,
) -> Reconstruction:
    """Nothing is trained: the exposures with their variances and the true surface are the scene.

    Args:
        problem: The problem; it holds the noise-free exposures and the true surface.
        config: All choices.
        progress: Called once.
        checkpoint: Not used: there is nothing to resume.

    Raises:
        LacksInput: If the problem lacks one of these, or the linear 16-bit pictures.
    """
    started = time.perf_counter()
    # First of all, while nothing else takes memory: for these all pictures are read.
    params = parameters_of_all(problem, config.enhance, config.pictures)
    clean, surface, linear16 = problem.clean, problem.surface, problem.linear16
    if clean is None or surface is None or linear16 is None:
        wanted = {"the noise-free exposures": clean, "the true surface": surface,
                  "the linear 16-bit pictures": linear16}  # fmt: skip
        missing = ", ".join(name for name, value in wanted.items() if value is None)
        raise LacksInput(f"averaging over views by truth needs {missing}, and this capture has none")
    device = problem.views.viewmats.device
    known, training = cameras_of(surface, config.tolerance), surface.training
    noise = noise_of(problem)
    noises = [noise.at(exposure).linear16 for exposure in problem.exposures or (1.0,) * len(clean)]
    exposures, variances = _exposures(linear16.cpu(), clean.cpu(), noises, config.exposures)

    def enhance(dark: Tensor, view: int) -> Tensor:
        return enhanced_like(dark.to(device), config.enhance, params[view]).cpu()

    scene = AveragedScene(
        sources=[known[i] for i in training], exposures=exposures, variances=variances, known=known,
        rules=Rules(kernel=config.kernel, coarsest=config.coarsest, mixed=False), enhance=enhance,
    )  # fmt: skip
    if progress is not None:
        progress(1, 1, {})
    return Reconstruction(
        scene=scene,
        space="enhanced",
        config=config,
        enhancement=enhancement_record(config.enhance, config.pictures),
        seconds={"all": time.perf_counter() - started},
    )


def cameras_of(surface: TrueSurface, tolerance: float) -> list[SurfaceCamera]:
    """The cameras of all views with their surfaces."""
    return [SurfaceCamera.of(*view, tolerance)
            for view in zip(surface.viewmats, surface.Ks, surface.depth, surface.normals, strict=True)]  # fmt: skip


def _exposures(
    noisy: Tensor, clean: Tensor, noises: Sequence[Variance], exposures: Literal["noisy", "noise-free"]
) -> tuple[EachView, EachView]:
    """The exposures in linear light and the variance of their noise, [H, W, 3] of each view.

    The variance is that at the true mean: at the noisy value itself, bright outliers would lose weight.

    Args:
        noisy: The linear 16-bit pictures.
        clean: Those without noise, sRGB-encoded.
        noises: Of the linear ones, view by view.
        exposures: Which of both are averaged.
    """

    def light(view: int) -> Array:
        return np.asarray(srgb_to_linear(clean[view].double().numpy()), np.float64)

    def variance(view: int) -> Array:
        found: Array = noises[view](clean.new_tensor(light(view)).double()).numpy()
        return found

    # Without the floor a camera without noise would divide by zero.
    least = LEAST * max(max(float(variance(view).max()) for view in range(len(clean))), LEAST)
    linear = light if exposures == "noise-free" else lambda view: noisy[view].double().numpy()
    return EachView(linear, len(clean)), EachView(lambda view: np.maximum(variance(view), least), len(clean))
