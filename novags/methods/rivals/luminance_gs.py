"""Luminance-GS (Cui et al. 2025): two colours for each Gaussian, dark and lit; the lit ones learn from curves.

The dark picture is the camera's. The lit one is drawn to the dark picture after a curve that is learned with it
(`luminance_curve.py`), and to local contrasts that are larger than the dark picture's. The curve is drawn to the
equalisation of the histogram. With G = (1 - w) L1 + w (1 - SSIM),

    loss = G(dark render, dark) + 1/2 G(lit render, curve(dark)) + contrast + 10 histogram

Differences from the publication: Gaussians are relocated as in 3DGS-MCMC instead of being split and pruned by
gradients, and regularised as there, as for all methods here; the experiment sets the iterations, not 10,000; the
attention layers see pictures of at most `seen` px a side, which a CPU can afford, and poses in the units of the set,
where its program brings all scenes to one size; and the bias of the dark colour changes only the constant harmonic.
"""

import dataclasses
import time
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from novags.methods.enhanced.gaussian_fit import fit_for, reconstructed
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem, gathered
from novags.methods.reconstruction import Progress, Reconstruction
from novags.methods.rivals.luminance_curve import ViewCurves, equalising_curve
from novags.methods.rivals.rows.luminance_gs import LuminanceGsConfig
from novags.methods.start import start_gaussians
from novags.splats.training.companion import Companion
from novags.splats.training.fit import fit
from novags.splats.training.losses import photometric_loss
from novags.splats.training.step import Step

LATER, THEN = 0.3, 0.1  # of the run, after which the histogram counts so much: 3,000 of 10,000 iterations
DARKEST = 1 / 510  # mean of a picture, half a code of 8 bits: a black one asks for no contrast


def contrasts(picture: Tensor) -> Tensor:
    """Differences of cells of 4 x 4 px from their neighbours, black beyond the border: [H, W, 3] -> [4, h, w]."""
    height, width = picture.shape[:2]
    cells = F.avg_pool2d(picture.mean(-1)[None, None], (min(4, height), min(4, width)))[0, 0]
    wide = F.pad(cells, (1, 1, 1, 1))
    near = (wide[1:-1, :-2], wide[1:-1, 2:], wide[:-2, 1:-1], wide[2:, 1:-1])
    return torch.stack([cells - other for other in near])


def contrast_loss(dark: Tensor, lit: Tensor, factor: float) -> Tensor:
    """Mean over cells of the summed squares of factor x contrast of the dark picture - contrast of the lit one."""
    return (factor * contrasts(dark) - contrasts(lit)).square().sum(0).mean()


def histogram_loss(curve: Tensor, shape: Tensor, equalising: Tensor, weight: float) -> Tensor:
    """The terms that shape the curve of a view: the equalising curve by a weight, its own shape, and smoothness."""
    smooth = curve.diff().square().mean()
    shaped = (shape - curve).square().mean() + 0.01 * (shape - equalising).square().mean()
    return weight * (curve - equalising).square().mean() + 0.1 * smooth + 0.5 * shaped


class LuminanceLoss:
    """The photometric loss of an iteration; its parts by name, once it was called, in `parts`."""

    def __init__(self, curves: ViewCurves, config: LuminanceGsConfig) -> None:
        self.curves, self.config = curves, config
        self.equalising = [equalising_curve(picture) for picture in curves.pictures]
        self.means = [max(float(picture.mean()), DARKEST) for picture in curves.pictures]

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss of a Step whose render is lit and whose target is dark."""
        config, view = self.config, step.view
        curve, shape = self.curves.curves(view)
        dark = photometric_loss(step.splat(dark_colors(step)), target, config.fit.dssim_weight)
        bright = self.curves.brightened(view, curve)
        lit = photometric_loss(step.render, bright, config.fit.dssim_weight)
        contrast = contrast_loss(target, step.render, config.contrast / self.means[view])
        weight = 1.0 if step.iteration < LATER * step.iterations else THEN
        histogram = histogram_loss(curve, shape, self.equalising[view], weight)
        extra = config.contrast_weight * contrast + config.histogram_weight * histogram
        return dark + config.lit_weight * lit + extra


def dark_colors(step: Step) -> Tensor:
    """The dark colours [N, K, 3]: k x the lit ones + b; k and b are the features of a Gaussian."""
    features, sh = step.gaussians.features, step.gaussians.sh
    assert features is not None
    scaled = features[:, None, :3] * sh
    return torch.cat([scaled[:, :1] + features[:, None, 3:], scaled[:, 1:]], 1)


def companion_of(curves: ViewCurves, config: LuminanceGsConfig) -> Companion:
    """The curves with their optimiser: all rates fall to a hundredth."""
    attentions = [*curves.bend.parameters(), *curves.shape.parameters()]
    adam = torch.optim.Adam(
        [
            {"params": [curves.curve], "lr": config.curve_rate, "weight_decay": 1e-4},
            {"params": attentions, "lr": config.attention_rate, "weight_decay": 1e-5},
            {"params": [curves.first, curves.second], "lr": config.axes_rate, "weight_decay": 1e-4},
        ]
    )
    return Companion(network=curves, optimizer=adam, cool_to=0.01)


def train(
    problem: Problem, config: LuminanceGsConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct a lit scene from dark pictures; see `Method.train`.

    Returns:
        A reconstruction whose colours are the lit ones; `targets` are the dark pictures through their curves.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=fit_for(problem, config.fit))
    dark = problem.encoded(config.pictures)
    start = start_gaussians(problem.start, dark, dark, sh_degree=config.fit.sh_degree, init_scale=config.init_scale)
    start.features = torch.cat([torch.ones(len(start), 3), torch.zeros(len(start), 3)], 1).to(start.means)
    with torch.random.fork_rng([]):
        torch.manual_seed(problem.seed)
        curves = ViewCurves(dark, problem.views.viewmats, config.seen).to(dark.device)
    result = fit(
        start, problem.views, lambda i: dark[i], config.fit, photometric=LuminanceLoss(curves, config),
        companion=companion_of(curves, config), progress=progress, checkpoint=checkpoint,
    )  # fmt: skip
    with torch.no_grad():
        each = (curves.brightened(i, curves.curves(i)[0]).clamp(0, 1) for i in range(len(dark)))
        bright = gathered(each, dark)
    scene = GaussianScene.of(result.gaussians, config.fit)
    return reconstructed(result, config, scene, "lit", started, targets=bright)
