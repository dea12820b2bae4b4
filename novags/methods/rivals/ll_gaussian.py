"""The decomposition of LL-Gaussian (Sun et al. 2025): reflectance, illumination and interference of Gaussians.

    dark picture = R S + N,      lit colour of a Gaussian = its reflectance x its illumination**gamma

R, S and N are rendered reflectance, illumination and interference: harmonics, one number and three numbers of each
Gaussian. With |N| the rendered size of the interference and G = (1 - w) L1 + w (1 - SSIM),

    loss = G(R S + N, dark) + a |grad S| exp(-EDGE |grad R|) + b |S - max over channels of dark| + c |N|

R and S are multiplied pixel by pixel. Multiplied for each Gaussian, some overlapping Gaussians would hold the light and
others the paint, which no loss of a picture can tell from both together; measured, the light then stays in R.

The publication has its parts from networks at the anchors of Scaffold-GS, two sets of Gaussians (the scene, and the
interference), a start from DUSt3R, and a diffusion model and a depth network as priors, which need weights that are not
here. Only the decomposition is taken from it; the terms above are common to Retinex methods, their weights were chosen
by us, once, and gamma brings the mean of the lit training views to `target`.
"""

import dataclasses
import time
from pathlib import Path

import torch
from torch import Tensor

from novags.methods.enhanced.gaussian_fit import fit_for, reconstructed
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction
from novags.methods.rivals.retinex import DIMMEST, smoothness
from novags.methods.rivals.rows.ll_gaussian import LlGaussianConfig
from novags.splats.gaussians import Gaussians
from novags.splats.sh import C0
from novags.splats.training.fit import fit
from novags.splats.training.losses import photometric_loss
from novags.splats.training.step import Step
from novags.splats.views import Views

GAMMAS = (0.01, 1.0)  # between which gamma is looked for


def parts_of(gaussians: Gaussians) -> tuple[Tensor, Tensor]:
    """Illumination [N, 1] and interference [N, 3]."""
    assert gaussians.features is not None
    return gaussians.features[:, :1].exp(), gaussians.features[:, 1:]


def shaded(sh: Tensor, factor: Tensor) -> Tensor:
    """Harmonics [N, K, 3] of factor [N, 1] x colour."""
    scaled = factor[..., None] * sh
    base = 0.5 * (factor - 1) / C0  # colours are 0.5 above the harmonics
    return torch.cat([scaled[:, :1] + base[..., None], scaled[:, 1:]], 1)


class DecompositionLoss:
    """The photometric loss of a Step whose render is the reflectance and whose target is dark."""

    def __init__(self, config: LlGaussianConfig) -> None:
        self.config = config

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss."""
        light, noise = parts_of(step.gaussians)
        maps = step.splat(torch.cat([light, noise, noise.abs()], 1))
        dark = step.render * maps[..., :1] + maps[..., 1:4]
        return (
            photometric_loss(dark, target, self.config.fit.dssim_weight)
            + self.config.smooth_weight * smoothness(maps[..., :1], step.render)
            + self.config.bright_weight * (maps[..., 0] - target.amax(-1)).abs().mean()
            + self.config.sparse_weight * maps[..., 4:].mean()
        )


def first(problem: Problem, dark: Tensor, config: LlGaussianConfig) -> Gaussians:
    """Gaussians at the first points, lit by the brightest channel of their colours."""
    colors = problem.start.colors.to(dark)
    light = colors.amax(-1, keepdim=True).clamp_min(DIMMEST)
    start = Gaussians.from_points(
        problem.start.points.to(dark), colors / light, sh_degree=config.fit.sh_degree, init_scale=config.init_scale
    )
    start.features = torch.cat([light.log(), torch.zeros_like(colors)], 1)
    return start


def lit(gaussians: Gaussians, gamma: float) -> Gaussians:
    """The Gaussians in their lit colours, without features."""
    light, _ = parts_of(gaussians)
    return dataclasses.replace(gaussians, sh=shaded(gaussians.sh, light**gamma), features=None)


def chosen_gamma(scene: GaussianScene, views: Views, target: float) -> float:
    """The gamma that brings the mean of the lit views to the target; the nearest of those tried."""
    low, high = GAMMAS
    for _ in range(20):
        middle = (low + high) / 2
        shown = dataclasses.replace(scene, gaussians=lit(scene.gaussians, middle))
        means = [float(shown.render(view)[0].clamp(0, 1).mean()) for view in views.each()]
        low, high = (middle, high) if sum(means) / len(means) > target else (low, middle)
    return middle


def train(
    problem: Problem, config: LlGaussianConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct reflectance and illumination from dark pictures; see `Method.train`.

    Returns:
        A reconstruction in lit colours; `found` has gamma.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=fit_for(problem, config.fit))
    dark = problem.encoded(config.pictures)
    result = fit(
        first(problem, dark, config), problem.views, lambda i: dark[i], config.fit,
        photometric=DecompositionLoss(config), progress=progress, checkpoint=checkpoint,
    )  # fmt: skip
    scene = GaussianScene.of(result.gaussians, config.fit)
    gamma = chosen_gamma(scene, dataclasses.replace(problem.views, viewmats=result.viewmats), config.target)
    shown = dataclasses.replace(scene, gaussians=lit(result.gaussians, gamma))
    return reconstructed(result, config, shown, "lit", started, found={"gamma": gamma})
