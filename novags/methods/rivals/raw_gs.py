"""Gaussians in linear light, fitted to raw data by the loss of RawNeRF, as LE3D does.

    loss = mean of  ((min(render, white) - datum) / (sg(render) + EPSILON))**2

of Mildenhall et al. 2022, section 4.1; sg holds its argument fixed. Divided by the render, an error counts as the tone
curve log(y + EPSILON) would show it. The derivative of that curve weighs the residual, instead of the curve bending the
noise, so that noise of mean zero averages out. Data are never clipped at black. Behind a colour filter array only
measured channels are compared.

Differences from the publications: RawNeRF is a field, and LE3D makes colours with a small network from features of each
Gaussian; here they are spherical harmonics of the light, as in 3DGS, in a unit that brings bright light to 1. LE3D's
start from a cone of random points and its two regularisers of distances are left out; the fit is 3DGS-MCMC, as for all
methods. A colour matrix is applied to the unclipped light of the render, whereas the development of pictures clips at
white first.
"""

import dataclasses
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from novags.methods.enhanced.gaussian_fit import fit_for, reconstructed
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.applying import enhanced
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.light import MeasuredLight, brightness, first_light, problem_light, raw_loss
from novags.methods.noise_estimate import noise_of
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction
from novags.methods.rivals.rows.raw_gs import RawGsConfig
from novags.splats.gaussians import Gaussians
from novags.splats.training.fit import fit
from novags.splats.training.step import Step


class RawLoss:
    """The loss of a render against data; nan data are left out. A `PixelLoss`.

    Attributes:
        white: Where each channel saturates, [3], unit of the render.
        epsilon: In the same unit.
    """

    def __init__(self, white: Tensor, epsilon: float) -> None:
        self.white, self.epsilon = white, epsilon
        self._white = white.cpu().numpy().astype(np.float32)

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss by autograd, on any device."""
        return raw_loss(step.render, target, self.epsilon, self.white.to(step.render))

    def compare(self, image: np.ndarray, target: np.ndarray) -> tuple[np.float32, np.ndarray]:
        """The loss of float32 arrays [H, W, 3], and its gradient for the image."""
        there = ~np.isnan(target)
        count = max(1, int(there.sum()))
        scale = 1 / (image + np.float32(self.epsilon))
        residual = np.where(there, np.minimum(image, self._white) - target, np.float32(0)) * scale
        gradient = residual * scale * np.float32(2 / count)
        gradient[image > self._white] = 0
        return np.float32(np.square(residual, dtype=np.float64).sum() / count), gradient


def train(
    problem: Problem, config: RawGsConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct the light of a scene from raw frames, or from linear 16-bit pictures; see `Method.train`.

    Returns:
        A reconstruction in linear light, in the unit of the linear 16-bit pictures. Seconds: "fit".

    Raises:
        LacksInput: If the problem has neither raw frames nor 16-bit linear pictures.
        ValueError: If the pictures hold no light; and as `Method.train` says.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=fit_for(problem, config.fit))
    data = problem_light(problem, noise_of(problem), problem.channels_share)
    unit = brightness(data.light)
    start = _start(problem, data, unit, config)
    loss = RawLoss(data.white / unit, config.epsilon / unit)
    result = fit(
        start, problem.views, lambda i: data.light[i] / unit, config.fit, photometric=loss, checkpoint=checkpoint,
        progress=progress,
    )  # fmt: skip
    matrix = torch.eye(3) if data.matrix is None else data.matrix.cpu()
    scene = dataclasses.replace(GaussianScene.of(result.gaussians, config.fit), matrix=unit * matrix)
    return reconstructed(
        result, config, scene, "linear", started, found={"unit": unit}, along=scene.along(result.kept),
        enhancement=enhancement_record(config.enhance, config.pictures),
        enhanced=enhanced(problem, config.enhance, config.pictures),
    )  # fmt: skip


def _start(problem: Problem, data: MeasuredLight, unit: float, config: RawGsConfig) -> Gaussians:
    """Gaussians at the first points, in the light that the dark pictures show there."""
    colors = (first_light(problem.start, data) / unit).clamp(0, 1).to(data.light)
    points = problem.start.points.to(data.light)
    return Gaussians.from_points(points, colors, sh_degree=config.fit.sh_degree, init_scale=config.init_scale)
