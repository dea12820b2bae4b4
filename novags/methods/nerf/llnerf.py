"""LLNeRF: a field whose colour is reflectance times illumination; the illumination is then brightened.

    c    = R L                                 R: [3], of the place;  L: of the place and the direction
    c_e  = R (L / (a + 1e-4))^(1 / (g + 2.2))  a, g [3]: of the place, sigmoids
    loss = RawNeRF's(C, y)
           + 0.1 exposure: mean over rays of (mean of the channels of C_e - 0.55)^2
           + 0.1 grey: mean over rays of sqrt(3 var C_e / (var(R / largest R) + 0.5)), var between channels
           + 0.1 smoothness of each of a and g: mean of 1.5 D^2 / ((D log(L + 1e-4))^2 + 1e-4), D between neighbouring
             pixels
           + 0.01 mean(g^2)

The terms of the enhancement are added once the colours are learnt, and take R and L as given. Wang et al. 2023,
"Lighting up NeRF via unsupervised decomposition and enhancement", and the forms and constants of its published code. It
uses no statistic of a well-lit picture.

Differences from the original: The field of novags.fields starts dense at the first points and as dark as the pictures,
with its steps and rays. The enhancement comes in for the last quarter of the steps, not for the last 5,000 of 105,000,
which is a twentieth: of as few steps as ours, at rates that have fallen, that would be too short to move a and g.
Pixels come in squares of four. Exponents, sigmoids and weights are as published. The mean of g^2 is over rays here,
over samples there. a and g are outputs of the field's one network and of the place alone; there a network of its own
makes them of features of L, which know the direction and are held fixed: here the terms of the enhancement move R and L
after all, through the features that they share with a and g.
"""

import dataclasses
import math
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from novags.fields.training.batch import Batch
from novags.methods.light import raw_loss
from novags.methods.nerf.fitting import fitted_scene, reconstructed, with_outputs
from novags.methods.nerf.losses import differences
from novags.methods.nerf.rows.ll_nerf import LlnerfConfig
from novags.methods.nerf.shading import brightened, split
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction

EPSILON = 1e-3  # of RawNeRF's loss, for pictures in 0..1
SMOOTH, LEAST_STEP, LEAST_SPREAD = 1.5, 1e-4, 0.5  # of the smoothness and of the grey term, as published
DARKEST = 1e-4  # of an illumination whose logarithm is taken, as published
LEAST_ROOT = 1e-12  # of the grey term before its root: on a grey ray the root would have an infinite slope
FIRST = 1e-3  # nearest to 0 and 1/2 that the mean of pictures counts for the first illumination: its logit diverges


@dataclass(frozen=True)
class Decomposed:
    """Colours of rays: dark and enhanced [R, 3], R [R, 3], L [R, 1], a [R, 1], g [R, 3]."""

    dark: Tensor
    lit: Tensor
    reflectance: Tensor
    illumination: Tensor
    level: Tensor
    gamma: Tensor


def first_illumination(images: Tensor) -> float:
    """Logit of the illumination at which the field's first reflectance, 1/2, looks as dark as the pictures.

    A field that begins brighter than they are becomes darker by becoming thinner, and loses the first surfaces.
    """
    mean = min(max(float(images.mean()), FIRST), 0.5 - FIRST)
    return math.log(mean / (0.5 - mean))


def decomposed(batch: Batch, first: float) -> Decomposed:
    """The colours of the rays of a batch; first: from `first_illumination`."""
    reflectance, illumination, level, gamma = split(batch.raw, first)
    values = (
        reflectance * illumination, reflectance.detach() * brightened(illumination.detach(), level, gamma), reflectance,
        illumination, level, gamma,
    )  # fmt: skip
    return Decomposed(*(batch.rendered(value) for value in values))


def enhancement_loss(seen: Decomposed, patch: int, config: LlnerfConfig) -> Tensor:
    """The terms of the enhancement, for squares of `patch` pixels in a row."""

    def steps(values: Tensor) -> Tensor:
        squares = values.reshape(-1, patch, patch, values.shape[1])
        return torch.stack([differences(squares[..., i]) for i in range(values.shape[1])], -1)

    edges = steps(torch.log(seen.illumination.detach() + DARKEST)).square() + LEAST_STEP
    smooth = [(SMOOTH * steps(values).square() / edges).mean() for values in (seen.level, seen.gamma)]
    paint = seen.reflectance.detach()
    paint = paint / paint.max().clamp_min(torch.finfo(paint.dtype).tiny)  # a batch of rays through nothing has none
    spread = 3 * seen.lit.var(1, unbiased=False) / (paint.var(1, unbiased=False) + LEAST_SPREAD)
    return (
        config.exposure * (seen.lit.mean(1) - config.mean).square().mean()
        + config.grey * spread.clamp_min(LEAST_ROOT).sqrt().mean()
        + config.smooth * (smooth[0] + smooth[1])
        + config.gamma * seen.gamma.square().mean()
    )


def train(
    problem: Problem, config: LlnerfConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct a scene as it would look lit, from dark pictures alone; see `Method.train`.

    Returns:
        A reconstruction in the space "lit". `found`: mean illumination of the last rays.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=with_outputs(config.fit, problem, static=7, viewed=1))
    problem = problem.to("cpu")
    images, seen_last = problem.encoded(config.pictures), [math.nan]
    first = first_illumination(images)

    def loss(batch: Batch) -> Tensor:
        seen = decomposed(batch, first)
        seen_last[0] = float(seen.illumination.detach().mean())
        value = raw_loss(seen.dark, batch.of(images), EPSILON)
        if batch.iteration >= config.learnt * config.fit.iterations:
            value = value + enhancement_loss(seen, config.fit.patch, config)
        return value

    scene, found = fitted_scene(
        problem, loss, config.fit, "retinex", numbers={"illumination": first}, progress=progress, checkpoint=checkpoint
    )
    last = None if math.isnan(seen_last[0]) else seen_last[0]
    return reconstructed(scene, found, config, "lit", started, found={"illumination": last})
