"""I2-NeRF: the dark is a medium that absorbs light on its way to the camera; without it the scene is lit.

    dark colour  I = sum_i  w_i t_i c_i     t_i = exp(-sum_{j <= i} s_j d_j)     s: absorption, an output of the field
    lit colour   J = sum_i  w_i c_i         w, c: as in NeRF                       d: width of a sample's interval
    loss = RawNeRF's(I, y)
           + 1 - SSIM(J, luminance-mapped y) over a stochastic square (S3IM)
           + 1e-3 bright channel: (1 - max of J over channels and a square)^2
           + 1e-3 overlap: mean over rays of sum_i w_i (1 - exp(-s_i d_i)): the medium is where the surface is not
           + 0.1 variation of s along a ray
           + 10 mean over the levels of the field of their mean squared feature

The mapping of y brings its mean to `mean` and its contrast to `contrast` times its value before. Liu et al. 2025,
"I2-NeRF: learning neural radiance fields under physically-grounded media interactions", and the published code's
weights.

The original takes `mean` and `contrast` for each scene from a REFERENCE IMAGE of it in good light (0.364 to 0.544, and
3.57 to 10): a statistic of the truth. Here they are one number for all scenes, from the middle of those ranges;
`truth_statistics` takes the mean, not the contrast, from well-lit pictures of the training views, is off by default,
and such runs are marked as seeing truth.

Further differences from the original: t counts the sample's own interval, there only earlier intervals. The variation
is the mean over a ray's samples, there their sum, some 95 times as much. The overlap is there the mean of s max(density
- 0.2, 0), with the density held fixed. The bright channel is there the dark picture's, an estimate of t at the surface,
which is drawn to it. S3IM has the windows of our SSIM, there 4 x 4 pixels side by side. The field of novags.fields
starts dense at the first points, in a medium that already makes renders as dark as the pictures. The loss of depth
(weight 0.1) is left out, because it needs a network for monocular depth, which is not here. The square of S3IM is made
of rays at random, as there, of 64 x 64 pixels or fewer, and is one, there ten. The mapped y is cut to 0..1, there it is
not, and its mean before is the luminance of all pictures, there the mean of a batch's channels.
"""

import dataclasses
import math
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from novags.fields.box import Box, box_of
from novags.fields.layout import DENSITY_MAX
from novags.fields.training.batch import Batch
from novags.methods.inputs import LacksInput
from novags.methods.light import raw_loss
from novags.methods.nerf.fitting import fitted_scene, reconstructed, with_outputs
from novags.methods.nerf.losses import grey_of
from novags.methods.nerf.rows.i2_nerf import I2Config
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction
from novags.splats.training.losses import ssim

EPSILON = 1e-3  # of RawNeRF's loss, for pictures in 0..1
LARGEST = 64  # px; side of the squares of S3IM
DARKEST, LIGHTEST = 1e-3, 0.45  # mean of dark pictures that the first absorption is made for


def first_absorption(images: Tensor, box: Box) -> float:
    """The absorption s that makes dark pictures of this mean out of the first colours, 1/2, halfway through the scene.

    In clear air, a field that begins brighter than the pictures becomes darker by becoming thinner, and loses the
    first surfaces.
    """
    mean = min(max(float(images.mean()), DARKEST), LIGHTEST)
    return math.log(0.5 / mean) / (0.5 * box.middle / box.unit)


def absorption(raw: Tensor, first: float) -> Tensor:
    """The absorption s [R, N], per unit of the box; first: where the output of the field is 0."""
    return torch.exp((raw[..., 1] + math.log(first)).clamp_max(DENSITY_MAX))


def seen_through(batch: Batch, first: float) -> tuple[Tensor, Tensor, Tensor]:
    """Dark colours I and lit colours J [R, 3], and s [R, N]; first: as for `absorption`."""
    colors, medium = torch.sigmoid(batch.raw[..., -3:]), absorption(batch.raw, first)
    through = torch.exp(-torch.cumsum(medium * batch.samples.widths, 1))
    return batch.rendered(through[..., None] * colors), batch.rendered(colors), medium


def mapped(image: Tensor, average: float, mean: float, contrast: float) -> Tensor:
    """A dark picture with its mean brought from `average` to `mean`, and its differences grown, in 0..1."""
    return (mean + contrast * (image - average)).clamp(0, 1)


def loss_of(
    dark: Tensor, lit: Tensor, medium: Tensor, batch: Batch, target: Tensor, aim: Tensor, config: I2Config
) -> Tensor:
    """The loss of colours [R, 3] for the pixels `target`, whose mapped twins are `aim`; medium: s [R, N]."""
    side = min(LARGEST, int(len(lit) ** 0.5))
    order = torch.from_numpy(_shuffled(len(lit), batch.iteration))[: side * side]
    squares = [image[order].reshape(side, side, 3) for image in (lit, aim)]
    channel = batch.squares(lit).amax((1, 2, 3))
    absorbed = 1 - torch.exp(-medium * batch.samples.widths)
    return (
        config.dark * raw_loss(dark, target, EPSILON)
        + config.structure * (1 - ssim(*squares))
        + config.bright * (1 - channel).square().mean()
        + config.overlap * (batch.weights * absorbed).sum(1).mean()
        + config.variation * (medium[:, 1:] - medium[:, :-1]).abs().mean()
    )


def _shuffled(count: int, iteration: int) -> np.ndarray:
    return np.random.default_rng([count, iteration]).permutation(count)


def train(
    problem: Problem, config: I2Config, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct a scene without the medium that hides it; see `Method.train`.

    Returns:
        A reconstruction in the space "lit". `found`: the mean that was aimed at, and the share of light that gets
        through the medium, on the last rays.

    Raises:
        LacksInput: If `truth_statistics` are wanted and the problem has none.
    """
    started = time.perf_counter()
    if config.truth_statistics and problem.lit_mean is None:
        raise LacksInput("truth_statistics needs well-lit pictures of the training views, and they are not known: "
                         "leave it off")  # fmt: skip
    mean = problem.lit_mean if config.truth_statistics and problem.lit_mean is not None else config.mean
    config = dataclasses.replace(config, fit=with_outputs(config.fit, problem, static=1, viewed=3))
    problem = problem.to("cpu")
    images = problem.encoded(config.pictures)
    aims = mapped(images, float(grey_of(images).mean()), mean, config.contrast)
    first = first_absorption(images, box_of(problem.views.centers, problem.start.points))
    last: dict[str, float] = {"mean": mean}

    def loss(batch: Batch) -> Tensor:
        dark, lit, medium = seen_through(batch, first)
        last["through"] = float(dark.detach().sum() / lit.detach().sum().clamp_min(1e-6))  # a black batch has no share
        return loss_of(dark, lit, medium, batch, batch.of(images), batch.of(aims), config)

    scene, found = fitted_scene(problem, loss, config.fit, "display", progress=progress, checkpoint=checkpoint)
    return reconstructed(scene, found, config, "lit", started, found=dict(last))
