"""Aleth-NeRF: a field whose dark views are seen through a concealing field; removing that lights the scene up.

    dark colour   C  = sum_i  w_i g_i O_i c_i        w: weights of the samples      g: one number per place along a ray
    lit colour    C* = sum_i  w_i c_i                O: local concealing, sigmoid of an output of the field, smoothed by
                                                        a filter of seven samples along the ray
    loss = MSE(f(C), f(y)) + 1e-3 (mean(C*) - ETA)^2 + 1e-3 structure + 1e-8 grey world
    f(x) = 1/2 - sin(asin(1 - 2 x) / 3)
    structure: mean of (D C* - ETA CONTRAST D y)^2 over neighbouring pixels, D their difference in grey

Cui et al. 2024, "Aleth-NeRF: illumination adaptive NeRF with concealing field assumption", and its published code's
constants for low light, the same for all scenes (ETA 0.45, CONTRAST 12). No statistic of a well-lit picture is used.

Differences from the original: The field of novags.fields starts dense at the first points, and by its first O as dark
as the pictures. Steps and rays per step are the same for all fields here, instead of 50,000 of 4,096 rays. Pixels come
in squares of four, because structure compares neighbours, each pair once; the original compares means of four rays in a
row of its batch with the means before and after, each pair twice. Its rays are drawn at random from one picture, so
that its pairs may lie far apart. Grey world is the sum of squared differences between the channels' means, there the
root of the sum of their fourth powers. Grey is luminance in structure, there the mean of the channels. O comes from an
output of the field's one network, where the original has a network of its own. Its filter runs along a ray; the
published filter runs over the rays of a batch at equal samples, and has an offset. A g below 0 lets nothing through.
There is one set of samples a ray, where the original sums the losses of a coarse and a fine one.
"""

import dataclasses
import math
import time
from pathlib import Path

import torch
from torch import Tensor

from novags.fields.training.batch import Batch
from novags.methods.nerf.fitting import fitted_scene, reconstructed, with_outputs
from novags.methods.nerf.losses import differences, grey_of
from novags.methods.nerf.rows.aleth_nerf import AlethConfig
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction

TAPS = 7  # of the filter along a ray
FIRST_ALONG = 0.5  # g at first, as published
DARKEST = 1e-3  # O at first for black pictures: at 0 its logit diverges


def tone(x: Tensor) -> Tensor:
    """1/2 - sin(asin(1 - 2 x) / 3) of x in 0..1: the inverse of 3 x^2 - 2 x^3, steep where it is dark."""
    # at 0 and 1 themselves the slope of the arc sine is infinite
    return 0.5 - torch.sin(torch.asin((1 - 2 * x).clamp(-1 + 1e-5, 1 - 1e-5)) / 3)


def first_concealing(images: Tensor) -> float:
    """Logit of the O at which the field's first colours, 1/2, look as dark as the pictures; 1/2 at most, as published.

    A field that begins brighter than they are becomes darker by becoming thinner, and loses the first surfaces.
    """
    share = min(max(float(images.mean()) / (0.5 * FIRST_ALONG), DARKEST), 0.5)
    return math.log(share / (1 - share))


def concealed(batch: Batch, along: Tensor, filter_: Tensor, first: float) -> tuple[Tensor, Tensor]:
    """Dark and lit colours [R, 3]; along: g [N]; filter_: of O, [7]; first: from `first_concealing`."""
    colors = torch.sigmoid(batch.raw[..., -3:])
    local = torch.nn.functional.conv1d(batch.raw[:, None, :, 1], filter_[None, None], padding=TAPS // 2)[:, 0]
    conceal = (along.clamp_min(0) * torch.sigmoid(local + first))[..., None]
    return batch.rendered(conceal * colors), batch.rendered(colors)


def loss_of(dark: Tensor, lit: Tensor, target: Tensor, patch: int, config: AlethConfig) -> Tensor:
    """The loss of dark and lit colours [R, 3] for the pixels `target` [R, 3], squares of `patch` in a row."""
    steps = [differences(grey_of(image).reshape(-1, patch, patch)) for image in (lit, target)]
    means = lit.mean(0)
    pairs = (means - means.roll(1)).square().sum()
    return (
        (tone(dark) - tone(target)).square().mean()
        + config.control * (lit.mean() - config.target).square()
        + config.structure * (steps[0] - config.target * config.contrast * steps[1]).square().mean()
        + config.grey * pairs
    )


def train(
    problem: Problem, config: AlethConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct a scene as it would look lit, from dark pictures alone; see `Method.train`.

    Returns:
        A reconstruction in the space "lit". `found`: the share of light that is let through, on average over the
        training views' last rays.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=with_outputs(config.fit, problem, static=1, viewed=3))
    problem = problem.to("cpu")
    images = problem.encoded(config.pictures)
    first, through = first_concealing(images), [math.nan]
    extra = {
        "along": torch.full((config.fit.samples,), FIRST_ALONG), "filter": torch.full((TAPS,), 1 / math.sqrt(TAPS)),
    }  # fmt: skip

    def loss(batch: Batch) -> Tensor:
        dark, lit = concealed(batch, extra["along"], extra["filter"], first)
        through[0] = float(dark.detach().sum() / lit.detach().sum().clamp_min(1e-6))  # a black batch has no share
        return loss_of(dark, lit, batch.of(images), config.fit.patch, config)

    scene, found = fitted_scene(
        problem, loss, config.fit, "display", extra=extra, progress=progress, checkpoint=checkpoint
    )
    last = None if math.isnan(through[0]) else through[0]
    return reconstructed(scene, found, config, "lit", started, found={"let_through": last})
