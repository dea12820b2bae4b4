"""Gaussian-DK (Ye et al. 2024): Gaussians hold radiance, and a learned camera response makes the dark pictures of it.

    picture = g(ln(radiance x exposure)),    loss = (1 - w) L1 + w (1 - SSIM) + ANCHOR |g(0) - 1/2|

g is a small network, the same for all colours and views; the last term fixes the unit of radiance. A larger exposure
gives the lit picture.

Differences from the publication, and open points in it: Its photographs had exposures of their own, here all views of a
capture come in one, so that g is only seen where the dark pictures are, and guessed beyond. g is a logistic curve and
a network that says nothing at first. The lit exposure brings the mean of the training views to `target`, where the
publication chooses by hand. Its scaling of gradients near the camera belongs to densification by gradients, which
3DGS-MCMC does without, as for all methods here.
"""

import dataclasses
import math
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from novags.methods.enhanced.gaussian_fit import fit_for, reconstructed
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem, gathered
from novags.methods.reconstruction import Progress, Reconstruction
from novags.methods.rivals.rows.gaussian_dk import GaussianDkConfig
from novags.methods.tone import ResponseTable
from novags.splats.gaussians import Gaussians
from novags.splats.training.companion import Companion
from novags.splats.training.fit import fit
from novags.splats.training.losses import photometric_loss
from novags.splats.training.step import Step

ANCHOR = 0.5  # weight of the term that fixes the unit of radiance
HIDDEN = 32
FAINT = 1e-4  # added to radiance: the logarithm of black has no slope that a fit could follow
BRIGHTEST = 1 - 1e-3  # of a code, for the first radiance: the radiance of white would be infinite
EXPOSURES = (1e-2, 1e5)  # between which the lit one is looked for
LEVELS = 1 << 16  # of the logarithm of radiance, by which the mean of pictures is found
ENTRIES = 512  # of the response as a table, over all logarithms that float32 colours can have between its ends
ENDS = (math.log(FAINT), 20.0)


class Response(nn.Module):
    """Codes 0..1 from the logarithm of the light on the sensor, of any shape; g(0) = 1/2 at first."""

    def __init__(self) -> None:
        super().__init__()
        self.inner = nn.Linear(1, HIDDEN)
        self.outer = nn.Linear(HIDDEN, 1)
        nn.init.zeros_(self.outer.weight)
        nn.init.zeros_(self.outer.bias)

    def forward(self, logs: Tensor) -> Tensor:
        """The codes, g(logs)."""
        bend = self.outer(torch.tanh(self.inner(logs[..., None])))[..., 0]
        return torch.sigmoid(logs + bend)


def logarithm(radiance: Tensor) -> Tensor:
    """Natural logarithm of radiance, finite for black."""
    return torch.log(radiance.clamp_min(0) + FAINT)


class ResponseLoss:
    """The photometric loss: the picture that a camera takes of the render, and the anchor."""

    def __init__(self, response: Response, dssim_weight: float) -> None:
        self.response, self.dssim_weight = response, dssim_weight

    def trained_along(self) -> list[Tensor]:
        """Parameters of the response."""
        return list(self.response.parameters())

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss of a Step whose render is radiance and whose target is a dark picture."""
        shown = self.response(logarithm(step.render))
        anchor = (self.response(step.render.new_zeros(1)) - 0.5).abs().sum()
        return photometric_loss(shown, target, self.dssim_weight) + ANCHOR * anchor


def radiance_of(codes: Tensor) -> Tensor:
    """Radiance that the response shows as these codes before it has learned anything."""
    codes = codes.clamp(0, BRIGHTEST)
    return (codes / (1 - codes) - FAINT).clamp_min(0)


@torch.no_grad()
def lit_exposure(response: Response, radiance: Tensor, target: float) -> float:
    """The exposure that brings the mean of pictures to the target; the nearest of those tried.

    The response need not rise everywhere: bisection on the logarithm finds one of the exposures at which it does.
    """
    # Counted levels in the place of all values of all views, through the network forty times: that would take more
    # memory and time than the fit.
    counts, edges = np.histogram(gathered(map(logarithm, radiance), radiance).cpu().numpy(), LEVELS)
    logs = torch.from_numpy((edges[:-1] + edges[1:]) / 2).to(radiance)
    weights = torch.from_numpy(counts / counts.sum()).to(radiance)
    low, high = (math.log(e) for e in EXPOSURES)
    for _ in range(40):
        middle = (low + high) / 2
        too_dark = float((weights * response(logs + middle)).sum()) < target
        low, high = (middle, high) if too_dark else (low, middle)
    return math.exp(middle)


@torch.no_grad()
def table_of(response: Response, exposure: float) -> ResponseTable:
    """The response to radiance under an exposure, as a table that needs no network."""
    logs = torch.linspace(*ENDS, ENTRIES, device=response.outer.bias.device)
    values = response(logs + math.log(exposure)).cpu()
    return ResponseTable(faint=FAINT, low=ENDS[0], high=ENDS[1], values=tuple(float(v) for v in values))


def train(
    problem: Problem, config: GaussianDkConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct radiance and camera response from dark pictures; see `Method.train`.

    Returns:
        A reconstruction that is shown under the lit exposure; `found` has it.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=fit_for(problem, config.fit))
    dark = problem.encoded(config.pictures)
    points, colors = problem.start.points.to(dark), radiance_of(problem.start.colors.to(dark))
    start = Gaussians.from_points(points, colors, sh_degree=config.fit.sh_degree, init_scale=config.init_scale)
    with torch.random.fork_rng([]):
        torch.manual_seed(problem.seed)
        response = Response().to(dark.device)
    adam = torch.optim.Adam(response.parameters(), lr=config.response_rate)
    result = fit(
        start, problem.views, lambda i: dark[i], config.fit,
        photometric=ResponseLoss(response, config.fit.dssim_weight),
        companion=Companion(network=response, optimizer=adam), progress=progress, checkpoint=checkpoint,
    )  # fmt: skip
    scene = GaussianScene.of(result.gaussians, config.fit)
    views = dataclasses.replace(problem.views, viewmats=result.viewmats)
    radiance = gathered((scene.render(view)[0][0] for view in views.each()), dark)
    exposure = lit_exposure(response, radiance, config.target)
    shown = dataclasses.replace(scene, response=table_of(response, exposure))
    return reconstructed(result, config, shown, "lit", started, found={"exposure": exposure})
