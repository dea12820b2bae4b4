"""LITA-GS (Zhou et al. 2025): lit Gaussians, their illumination, and a structure that no illumination changes.

    dark picture = h(S D),    D = clamp(R - N_3, 0, 1)

R, S and N_0 are rendered colours, illumination and noise of the Gaussians, N_3 is refined noise (`denoised_scene.py`)
and h a small network of colours. D is the lit picture, in training views and in new ones. With P the rendered
structure of the Gaussians and W the illumination-invariant structure of the dark picture (`invariant.py`),

    loss = (1 - w) L1 + w (1 - SSIM) of h(S D) and the dark picture + PRIOR |P - W|
           + a mean (16 px patches of D - 0.49)^2 + b |grad S| exp(-EDGE |grad R|) + c |grad D| (1 - W) + d |N_3|

Published: the parts, h(S D_3), the recursion of the noise, w = 0.2, the weight of the prior, 0.49, the learning
rates. Its released program lacks the training loop and the prior, and was not read. Chosen by us, once, for want of
them: which invariant of Kubelka-Munk theory the prior is, and its compression to 0..1; that the lit exposure is held
as Zero-DCE holds it; the terms that tell illumination from colour, and noise from both (a to d and their weights); h,
which changes nothing at first. Left out: the loss of depth (weight 0.1), for it needs the weights of a depth network.
Networks have 16 channels instead of 64, for two cores; `width` says otherwise.
"""

import dataclasses
import math
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from novags.methods.enhanced.gaussian_fit import fit_for, reconstructed
from novags.methods.enhancers.pictures import exposure
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction
from novags.methods.rivals.denoised_scene import DenoisedScene, StagedDenoiser
from novags.methods.rivals.invariant import structure
from novags.methods.rivals.retinex import DIMMEST, slopes, smoothness
from novags.methods.rivals.rows.lita_gs import LitaGsConfig
from novags.splats.gaussians import Gaussians
from novags.splats.training.companion import Companion
from novags.splats.training.fit import fit
from novags.splats.training.losses import photometric_loss
from novags.splats.training.step import Step
from sensor_model.isp import srgb_to_linear

HIDDEN = 32


class ToneMap(nn.Module):
    """The network h of colours [..., 3]; at first it changes nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.inner, self.outer = nn.Linear(3, HIDDEN), nn.Linear(HIDDEN, 3)
        nn.init.zeros_(self.outer.weight)
        nn.init.zeros_(self.outer.bias)

    def forward(self, colors: Tensor) -> Tensor:
        """The mapped colours, h(colors)."""
        out: Tensor = colors + self.outer(torch.tanh(self.inner(colors)))
        return out


class Networks(nn.Module):
    """The parts that learn beside the Gaussians."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.denoiser, self.tone = StagedDenoiser(width), ToneMap()


def parts_of(gaussians: Gaussians) -> tuple[Tensor, Tensor, Tensor]:
    """Illumination [N, 3], structure [N, 1] and noise [N, 3]."""
    assert gaussians.features is not None
    light, prior, noise = gaussians.features.split([3, 1, 3], 1)
    return light.exp(), torch.sigmoid(prior), noise


def flatness(lit: Tensor, structure: Tensor) -> Tensor:
    """Mean slope of the lit picture [H, W, 3] between pixels as far as the structure [H, W] sees no edge at either."""
    wide, high = slopes(lit)
    flat_x = 1 - torch.maximum(structure[:, 1:], structure[:, :-1])
    flat_y = 1 - torch.maximum(structure[1:], structure[:-1])
    return ((wide * flat_x).sum() + (high * flat_y).sum()) / structure.numel()


class LitaLoss:
    """The photometric loss of a Step whose render is lit, with its noise, and whose target is dark."""

    def __init__(self, networks: Networks, structures: Tensor, config: LitaGsConfig) -> None:
        self.networks, self.structures, self.config = networks, structures, config

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss."""
        config, seen = self.config, self.structures[step.view]
        maps = step.splat(torch.cat(parts_of(step.gaussians), 1))
        light, prior, noise = maps.split([3, 1, 3], -1)
        noise = self.networks.denoiser(noise)
        lit = (step.render - noise).clamp(0, 1)
        dark = self.networks.tone(light * lit)
        return (
            photometric_loss(dark, target, config.fit.dssim_weight)
            + config.prior_weight * (prior[..., 0] - seen).abs().mean()
            + config.exposure_weight * exposure(lit.permute(2, 0, 1)[None], config.exposure)
            + config.light_weight * smoothness(light, step.render)
            + config.smooth_weight * flatness(lit, seen)
            + config.noise_weight * noise.abs().mean()
        )


def first(problem: Problem, dark: Tensor, config: LitaGsConfig) -> Gaussians:
    """Gaussians at the first points, under one light, in which the lit ones have the exposure that is asked for."""
    colors = problem.start.colors.to(dark)
    light = max(float(dark.mean()), DIMMEST) / config.exposure
    start = Gaussians.from_points(
        problem.start.points.to(dark), (colors / light).clamp(0, 1), sh_degree=config.fit.sh_degree,
        init_scale=config.init_scale,
    )  # fmt: skip
    start.features = torch.cat([torch.full_like(colors, math.log(light)), torch.zeros(len(colors), 4).to(dark)], 1)
    return start


def structures_of(dark: Tensor) -> Tensor:
    """The structure of each dark picture [C, H, W, 3], sRGB code: [C, H, W]."""
    lights = (np.asarray(srgb_to_linear(picture.cpu().numpy()), np.float32) for picture in dark)
    return torch.stack([structure(torch.from_numpy(light)) for light in lights]).to(dark)


def companion_of(networks: Networks, config: LitaGsConfig) -> Companion:
    """The networks with their optimiser."""
    parts = (networks.denoiser, config.denoiser_rate), (networks.tone, config.tone_rate)
    adam = torch.optim.Adam([{"params": part.parameters(), "lr": rate} for part, rate in parts])
    return Companion(network=networks, optimizer=adam)


def train(
    problem: Problem, config: LitaGsConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct a lit scene from dark pictures; see `Method.train`.

    Returns:
        A reconstruction whose pictures are lit and denoised.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=fit_for(problem, config.fit))
    dark = problem.encoded(config.pictures)
    with torch.random.fork_rng([]):
        torch.manual_seed(problem.seed)
        networks = Networks(config.width).to(dark.device)
    result = fit(
        first(problem, dark, config), problem.views, lambda i: dark[i], config.fit,
        photometric=LitaLoss(networks, structures_of(dark), config),
        companion=companion_of(networks, config), progress=progress, checkpoint=checkpoint,
    )  # fmt: skip
    _, _, noise = parts_of(result.gaussians)
    base = GaussianScene.of(dataclasses.replace(result.gaussians, features=None), config.fit)
    scene = DenoisedScene(base, noise.detach().contiguous(), networks.denoiser.requires_grad_(False))
    return reconstructed(result, config, scene, "lit", started)
