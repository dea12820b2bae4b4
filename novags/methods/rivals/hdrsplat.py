"""HDRSplat (Singh et al. 2024): Gaussians in linear light, fitted to raw data that were denoised before.

    loss = (1 - w) mean of |x - t| / (sg(x) + EPSILON) + w (1 - SSIM(x, t)),    x = clamp(render, 0, 1)

t is the denoised picture, 1 = white, and sg holds its argument fixed; both terms are of linear light. Published: the
loss, w = 0.2, EPSILON, targets in 0..1, the four learning rates (`rows/hdrsplat.py`), harmonics of degree 3, which
its tuned runs ask for where its program has 2 by itself.

Differences from the publication: The data are denoised by our network (`denoised`), which knows the noise of the camera
and interpolates the mosaic too, where PMRID denoised a demosaiced picture. Captures in which bright light is below 0.02
of white are amplified to that, a number of ours: the learning rates are of brighter ones. The fit is 3DGS-MCMC, as for
all methods; 100,000 further points in the box of the scene every 5,000 steps, an option there, belong to its
densification and are left out.
"""

import dataclasses
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from novags.methods.denoised.config import parts
from novags.methods.denoised.kept import denoised_pictures
from novags.methods.enhanced.gaussian_fit import fit_for, reconstructed
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.applying import enhanced, enhanced_light
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.light import brightness
from novags.methods.problem import Problem, gathered
from novags.methods.reconstruction import Progress, Reconstruction, counted_on
from novags.methods.rivals.rows.hdrsplat import HdrsplatConfig
from novags.methods.start import start_gaussians
from novags.splats.training.fit import fit
from novags.splats.training.losses import compare, photometric_loss
from novags.splats.training.step import Step


class RelativeLoss:
    """The loss of a render against a denoised picture, both in linear light. A `PixelLoss`.

    Attributes:
        epsilon: EPSILON, unit of the render.
        dssim_weight: w.
    """

    def __init__(self, epsilon: float, dssim_weight: float) -> None:
        self.epsilon, self.dssim_weight = epsilon, dssim_weight

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss by autograd, on any device."""
        shown, w = step.render.clamp(0, 1), self.dssim_weight
        relative = ((shown - target).abs() / (shown.detach() + self.epsilon)).mean()
        return (1 - w) * relative + w * photometric_loss(shown, target, 1.0)

    def compare(self, image: np.ndarray, target: np.ndarray) -> tuple[np.float32, np.ndarray]:
        """The loss of float32 arrays [H, W, 3], and its gradient for the image."""
        shown, w = np.clip(image, np.float32(0), np.float32(1)), np.float32(self.dssim_weight)
        unlike, gradient = compare(shown, target, 1.0)
        scale, error = 1 / (shown + np.float32(self.epsilon)), shown - target
        relative = np.float32((np.abs(error) * scale).sum(dtype=np.float64) / error.size)
        gradient = w * gradient + (1 - w) / np.float32(error.size) * np.sign(error) * scale
        gradient[shown != image] = 0
        return (1 - w) * relative + w * unlike, gradient


def train(
    problem: Problem, config: HdrsplatConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct the light of a scene from denoised raw frames, or linear 16-bit pictures; see `Method.train`.

    Returns:
        A reconstruction in linear light, in the unit of the linear 16-bit pictures; `targets` are the denoised ones
        through the enhancement. Seconds: "denoise" and "fit".

    Raises:
        LacksInput: If the noise of the data is not known, or not independent.
        ValueError: If the denoised pictures hold no light; and as `Method.train` says.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=fit_for(problem, config.fit))
    light, earlier = denoised_pictures(problem, config, progress, checkpoint)
    denoising = earlier + time.perf_counter() - started
    started = time.perf_counter()
    unit = min(1.0, brightness(light) / config.least_bright)
    start = start_gaussians(
        problem.start, problem.srgb8, (view / unit for view in light), sh_degree=config.fit.sh_degree,
        init_scale=config.init_scale,
    )  # fmt: skip
    result = fit(
        start, problem.views, lambda i: (light[i] / unit).clamp(0, 1), config.fit,
        photometric=RelativeLoss(config.epsilon, config.fit.dssim_weight), checkpoint=checkpoint,
        progress=counted_on(progress, parts(config)["denoiser"]),
    )  # fmt: skip
    scene = dataclasses.replace(GaussianScene.of(result.gaussians, config.fit), matrix=unit * torch.eye(3))
    shown = gathered(enhanced_light(problem, light, config.enhance, config.pictures), light)
    made = reconstructed(
        result, config, scene, "linear", started, found={"unit": unit}, along=scene.along(result.kept), targets=shown,
        enhancement=enhancement_record(config.enhance, config.pictures),
        enhanced=enhanced(problem, config.enhance, config.pictures),
    )  # fmt: skip
    made.seconds = {"denoise": denoising, **made.seconds}
    return made
