"""Adapting a network to one capture without truth: recorrupted-to-recorrupted (Pang, Zheng, Quan, Ji 2021).

With z of the same variance as the noise of y, drawn anew,

    y1 = y + a z        y2 = y - z / a

have independent noise of variance (1 + a**2) and (1 + 1 / a**2) times the variance of y: independent for Gaussian
noise, uncorrelated for any. A network that predicts y2 from y1 learns the mean of y, as if y2 were a second exposure.
The variance of z is the known one at the network's own estimate of the mean before it is adapted; at y itself, z would
be correlated with the noise of dark pixels, whose variance cannot be negative.

How far the adapted network is followed is decided by the same two copies (see `blend`).

Of a mosaic, y2 says nothing about the channels that were not measured, and a network that is told nothing about them
forgets how to interpolate: there it is held to that first estimate.

Renders of a scene that was fitted to all views are a second teacher, if there are any: what they show of a view comes
from the others too.
"""

import math
from copy import deepcopy
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from novags.methods.denoised.blend import Blend, best_blend
from novags.methods.denoised.config import AdaptConfig
from novags.methods.denoised.estimate import estimate, estimate_all
from novags.methods.denoised.measured import MeasuredPictures
from novags.methods.denoised.network import Network
from novags.methods.denoised.packing import turned
from novags.methods.reconstruction import Progress
from novags.process import give_back
from novags.splats.training.companion import masked_step
from novags.splats.training.flags import Flags, tell

LEAST_VARIANCE = 1e-4  # electrons**2
ASKED = 8  # views that say how far to follow an adapted network
MOST = 1 << 22  # of their values, which bounds the memory


def recorrupted(data: Tensor, deviation: Tensor, strength: float, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Two copies of the data with uncorrelated noise.

    Args:
        data: Any shape.
        deviation: Standard deviation of its noise, the same shape.
        strength: a: the larger, the noisier the first copy and the less noisy the second.
        generator: Of the noise that is added.
    """
    z = deviation * torch.randn(data.shape, generator=generator, device=data.device, dtype=data.dtype)
    return data + strength * z, data - z / strength


@dataclass(frozen=True)
class Teacher:
    """Renders of the views, from which a network learns beside the data.

    Attributes:
        electrons: As `MeasuredPictures` has them, all channels [C, 3, H, W]; NaN where a render says nothing.
        weight: Of the squared distance from them in units of the noise of the data; 1: as much as a second exposure.
    """

    electrons: Tensor
    weight: float


class Adaptation:
    """A network in training on the pictures of one capture."""

    def __init__(
        self, network: Network, pictures: MeasuredPictures, config: AdaptConfig, seed: int,
        teacher: Teacher | None = None,
    ) -> None:  # fmt: skip
        self.network, self.pictures, self.config, self.teacher = network, pictures, config, teacher
        self.first = estimate_all(network, pictures.electrons, pictures.mask, pictures.read_variance, turns=1)
        self.flags = Flags.on(self.first.device)
        self.generator = torch.Generator(self.first.device).manual_seed(seed)
        # Of crops: their places are the host's to know. On a CPU one stream is for everything.
        self.places = self.generator if self.flags is None else torch.Generator().manual_seed(seed)
        self.optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
        self.step = 0

    def loss(self) -> Tensor:
        """Squared distance of the estimates for y1 from y2, in units of the noise of y2; see above for gaps in y2."""
        electrons, held, mask, *taught = self._crops()
        variance = self.variance(held)
        a = self.config.strength
        first, second = recorrupted(electrons, variance.sqrt(), a, self.generator)
        more = 1 + a**2
        # y1 has the noise of an exposure of 1 / more of the light: in its own electrons it is like any other picture.
        found = more * estimate(self.network, first / more, mask, self.pictures.read_variance / more)
        wanted = torch.where(mask > 0, second, held)
        loss = ((found - wanted).square() / (variance * (1 + 1 / a**2))).sum() / mask.sum()
        if self.teacher is not None:
            (render,) = taught
            apart = (found - torch.where(render.isnan(), found.detach(), render)).square() / variance
            loss = loss + self.teacher.weight * apart.mean()
        return loss

    def variance(self, first: Tensor) -> Tensor:
        """Of the data at these first estimates [..., 3, h, w]."""
        # Floor: where a camera counts nothing and reads without noise, a weight of 1 / 0.
        return self.pictures.variance(first).clamp_min(LEAST_VARIANCE)

    def advance(self) -> Tensor:
        """One step; returns the loss, a scalar, about 1 plus the error of the estimate.

        Raises:
            ValueError: If the loss is not finite; on a GPU `flags` are told instead.
        """
        rate = self.config.learning_rate * 0.5 * (1 + math.cos(math.pi * self.step / self.config.steps))
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        loss = self.loss()
        loss.backward()
        where = f"at step {self.step} of its adaptation: lower adapt.learning_rate, or set adapt to none"
        if self.flags is not None:
            self.flags.look({"the denoiser's loss": loss}, where)
        elif not torch.isfinite(loss):
            raise ValueError(f"the denoiser's loss must be finite, got {loss.item()} {where}")
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        masked_step(self.optimizer, None if self.flags is None else self.flags.bad)
        self.optimizer.zero_grad(set_to_none=True)
        self.step += 1
        return loss.detach()

    def blend(self, before: Network) -> Blend:
        """How far to follow this network, adapted from `before`, at each level of light, as some views tell."""
        a, p = self.config.strength, self.pictures
        views = sorted({round(i * (len(p.electrons) - 1) / (ASKED - 1)) for i in range(ASKED)})
        measured = torch.nonzero(p.mask[0].flatten())[:, 0]
        measured = measured[:: max(1, len(views) * len(measured) // MOST)]
        found = []
        for view in views:
            variance = self.variance(self.first[view])
            first, second = recorrupted(p.electrons[view], variance.sqrt(), a, self.generator)
            both = [_of_first(network, first[None], p, a)[0] for network in (before, self.network)]
            found.append([x.flatten()[measured] for x in (*both, second, variance)])
        return best_blend(*(torch.cat(each) for each in zip(*found, strict=True)))

    def _crops(self) -> list[Tensor]:
        """Random crops of data, first estimate, mask and renders, flipped and turned alike, [batch, 3, crop, crop]."""
        data, mask = self.pictures.electrons, self.pictures.mask
        taught = [] if self.teacher is None else [self.teacher.electrons]
        count, _, height, width = data.shape
        side = min(self.config.crop, height, width)
        parts = []
        for _ in range(self.config.batch):
            view, turn = self._integer(count), self._integer(8)
            top, left = self._integer(height - side + 1), self._integer(width - side + 1)
            window = (..., slice(top, top + side), slice(left, left + side))
            cut = [x[window] for x in (data[view], self.first[view], mask[0], *(one[view] for one in taught))]
            parts.append([turned(x[None], turn) for x in cut])
        return [torch.cat(each) for each in zip(*parts, strict=True)]

    def _integer(self, high: int) -> int:
        return int(torch.randint(high, (1,), generator=self.places))


def _of_first(network: Network, first: Tensor, pictures: MeasuredPictures, strength: float) -> Tensor:
    """The estimate for the first copy [B, 3, H, W], no gradient; see `Adaptation.loss` for its scale."""
    more = 1 + strength**2
    return more * estimate_all(network, first / more, pictures.mask, pictures.read_variance / more, turns=1)


@dataclass(frozen=True)
class Adapted:
    """A network before and after it was adapted to a capture, and how far to follow it."""

    before: Network
    after: Network
    blend: Blend

    def estimate_all(self, pictures: MeasuredPictures, *, turns: int) -> Tensor:
        """The means of the pictures, electrons [C, 3, H, W]; as `estimate_all`."""
        before, after = (estimate_all(network, pictures.electrons, pictures.mask, pictures.read_variance, turns=turns)
                         for network in (self.before, self.after))  # fmt: skip
        return self.blend(before, after)


def adapt(
    network: Network,
    pictures: MeasuredPictures,
    config: AdaptConfig,
    *,
    seed: int,
    progress: Progress | None = None,
    more: int = 0,
    teacher: Teacher | None = None,
) -> Adapted:
    """Adapt a copy of a network to a capture.

    Args:
        network: Pre-trained.
        pictures: Of the capture.
        config: All choices.
        seed: Of crops and noise.
        progress: Called after every step with (steps done, of how many, {"denoiser": loss}).
        more: Steps that are to follow after these, for `progress`.
        teacher: Renders to learn from beside the data.
    """
    after = deepcopy(network)
    training = Adaptation(after, pictures, config, seed, teacher)

    def report(step: int, loss: float) -> None:
        if progress is not None:
            progress(step, config.steps + more, {"denoiser": loss})

    give_back()
    for step in range(1, config.steps + 1):
        tell(training.flags, step, config.steps, training.advance(), partial(report, step))
    give_back()
    return Adapted(network, after, training.blend(network))
