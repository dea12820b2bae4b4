"""The self-supervised denoiser: blind-spot training on a scene's own enhanced views (paper, section 4.3).

Views come as [C, H, W, 3]; inside, batches are [B, D, H, W], D = 3, or 4 of packed mosaics. One `Denoiser` is one
network with its optimiser and its own random stream, so that a resumed run draws the same numbers as an uninterrupted
one.
"""

import math
from contextlib import AbstractContextManager

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.memory import MANY
from novags.methods.nova.blindspot import n2v_loss, replace_masked, sample_mask
from novags.methods.nova.denoiser_config import DenoiserConfig
from novags.methods.nova.packed import demosaiced, packed, turned
from novags.methods.nova.resunet import ResUNet
from novags.process import sparing
from novags.splats.training.companion import masked_step, pack, unpack
from novags.splats.training.flags import Flags
from novags.splats.training.guard import NotFinite, all_finite, require_finite
from sensor_model.params import Cfa


def donut_blur(images: Tensor, sigma: float) -> Tensor:
    """Gaussian blur whose kernel has no centre, so that no pixel influences its own value. images: [B, D, H, W].

    Except a little in the second row or column from a border, where reflection brings the pixel back. In training that
    is harmless: the picture that is blurred is blinded.
    """
    radius = min(max(1, math.ceil(3 * sigma)), *(side - 1 for side in images.shape[-2:]))
    offsets = torch.arange(-radius, radius + 1, dtype=images.dtype, device=images.device)
    line = torch.exp(-0.5 * (offsets / sigma) ** 2)
    kernel = torch.outer(line, line)
    kernel[radius, radius] = 0
    channels = images.shape[1]
    weight = (kernel / kernel.sum()).expand(channels, 1, -1, -1)
    return F.conv2d(F.pad(images, (radius,) * 4, mode="reflect"), weight, groups=channels)


class Denoiser:
    """A network in training on one scene's enhanced views."""

    def __init__(
        self, enhanced: Tensor, config: DenoiserConfig, *, total_steps: int, seed: int, cfa: Cfa | None = None,
        flags: Flags | None = None,
    ) -> None:  # fmt: skip
        """A network before its first step.

        Args:
            enhanced: [C, H, W, 3], 0..1.
            config: All choices, with `blind_spots.packed` decided.
            total_steps: Sets the length of the learning-rate decay.
            seed: Of weights, crops and masks.
            cfa: Colour filter array that the pictures were demosaiced from, for packed blind spots.
            flags: On a GPU, of all that is trained together; somebody else reads them.
        """
        if enhanced.ndim != 4 or enhanced.shape[-1] != 3 or 0 in enhanced.shape:
            raise ValueError(f"enhanced must be [C, H, W, 3], got {tuple(enhanced.shape)}")
        self.config, self.total_steps, self.step = config, max(1, total_steps), 0
        self.size = enhanced.shape[1:3]
        self.cfa = cfa if config.blind_spots.packed else None  # None: pictures, not mosaics
        images = enhanced.detach()
        self.images = images.movedim(-1, 1) if self.cfa is None else packed(images, self.cfa)  # the former: no copy
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = ResUNet(config.network, self.images.shape[1]).to(enhanced.device)
        if config.residual_blur is not None:
            # A network that starts at zero starts at the blur.
            for parameter in self.network.head.parameters():
                nn.init.zeros_(parameter)
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate, fused=True)
        self.flags = flags or Flags.on(enhanced.device)
        self.generator = torch.Generator(enhanced.device).manual_seed(seed)
        # Of crops: their places are the host's to know. On a CPU one stream is for everything.
        self.places = self.generator if self.flags is None else torch.Generator().manual_seed(seed)
        self.views: list[int] = []  # of the last batch

    def predict(self, images: Tensor) -> Tensor:
        """The network's estimate for images [B, D, H, W], differentiable, not clipped."""
        estimate = self.network(images.contiguous(memory_format=torch.channels_last))
        if self.config.residual_blur is not None:
            estimate = estimate + donut_blur(images, self.config.residual_blur)
        return estimate

    def loss(self) -> Tensor:
        """L_N2V of one random batch (equation 8)."""
        batch = self._draw_batch()
        spots = self.config.blind_spots
        planes = batch.flatten(0, 1).unsqueeze(1) if spots.per_channel else batch
        fraction = spots.fraction(self.images.shape[-2] * self.images.shape[-1])
        mask = sample_mask(planes, fraction, spots.laplacian_share, self.generator)
        blinded = replace_masked(planes, mask, spots.window, self.generator).view_as(batch)
        return n2v_loss(self.predict(blinded).reshape(planes.shape), planes, mask)

    def train_step(self) -> float | Tensor:
        """One optimiser step on L_N2V, plus the gradients that the network already holds. Returns the loss.

        Raises:
            NotFinite: If the loss or a gradient is not finite; the step has then changed nothing. On a GPU `flags` are
                told instead.
        """
        loss = self._checked_gradients() if self.flags is None else self._flagged_gradients(self.flags)
        rate = self.config.learning_rate
        if self.config.decay == "cosine":
            rate *= 0.5 * (1 + math.cos(math.pi * min(1, self.step / self.total_steps)))
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        masked_step(self.optimizer, None if self.flags is None else self.flags.bad)
        self.optimizer.zero_grad(set_to_none=True)
        self.step += 1
        return loss.item() if self.flags is None else loss.detach()

    def _checked_gradients(self) -> Tensor:
        """The loss, with its gradients in the network."""
        stream, held = self.generator.get_state(), self._gradients()
        held = {name: gradient.clone() for name, gradient in held.items()}  # none unless L_recon reaches the denoiser
        with self._sparing(self.config.crop):
            loss = self.loss()
            loss.backward()
        try:
            self._check(loss.item())
        except NotFinite:
            self.generator.set_state(stream)
            for name, parameter in self.network.named_parameters():
                parameter.grad = held.get(name)
            raise
        return loss

    def _flagged_gradients(self, flags: Flags) -> Tensor:
        loss = self.loss()
        loss.backward()
        looked = {"the denoiser's loss": loss}
        first = next(iter(self.network.parameters())).grad  # which speaks for all layers, see `_check`
        flags.look(looked if first is None else looked | {"the denoiser's gradient": first}, self._where())
        return loss

    def _gradients(self) -> dict[str, Tensor]:
        return {name: p.grad for name, p in self.network.named_parameters() if p.grad is not None}

    def _check(self, loss: float) -> None:
        """Raise NotFinite unless the loss and the gradients are finite.

        A gradient on its way back passes through the first convolution, which therefore speaks for all layers.
        """
        first = next(iter(self.network.parameters())).grad
        if math.isfinite(loss) and (first is None or all_finite([first])):
            return
        where = self._where()
        require_finite("denoiser weight", dict(self.network.named_parameters()), where, resumable=False)
        if not math.isfinite(loss):
            raise NotFinite(f"the denoiser's loss must be finite, got {loss} {where}")
        require_finite("denoiser gradient of", self._gradients(), where, resumable=True)

    def _where(self) -> str:
        return f"at denoiser step {self.step}, view {', '.join(map(str, self.views))}"

    def denoise(self, view: int) -> Tensor:
        """I_clean of one view, [H, W, 3] in 0..1: the network on the unmasked image.

        Differentiable in the weights, unless it was demosaiced.
        """
        with self._sparing(None):
            mixed = self._mixed(self.images[view : view + 1])
        if self.cfa is None:
            return mixed.movedim(0, -1)
        return demosaiced(mixed, self.cfa, *self.size).clamp(0, 1)  # its filters overshoot

    def denoised(self, picture: Tensor) -> Tensor:
        """Another picture [H, W, 3] of the same kind, denoised, without gradient; not of packed mosaics."""
        with torch.no_grad():
            return self._mixed(picture.movedim(-1, 0)[None]).movedim(0, -1)

    def _sparing(self, crop: int | None) -> AbstractContextManager[None]:
        """How memory is used where the network sees crops, or whole views."""
        height, width = (min(crop or side, side) for side in self.images.shape[-2:])
        return sparing(self.flags is None and height * width >= MANY)

    def _mixed(self, noisy: Tensor) -> Tensor:
        """The network's estimate for one picture [1, D, H, W], with the configured share of the picture: [D, H, W]."""
        noisy = noisy.contiguous()
        return torch.lerp(self.predict(noisy).clamp(0, 1), noisy, self.config.noisy_share)[0]

    def denoise_all(self) -> Tensor:
        """I_clean of all views, [C, H, W, 3] in 0..1, without gradient."""
        with torch.no_grad():
            return torch.stack([self.denoise(view) for view in range(len(self.images))])

    def _draw_batch(self) -> Tensor:
        """Random crops [batch, D, crop, crop], or whole views where no crop is configured."""
        count, _, height, width = self.images.shape
        rows, columns = min(self.config.crop or height, height), min(self.config.crop or width, width)
        self.views = views = self._integers(count)
        tops, lefts = self._integers(height - rows + 1), self._integers(width - columns + 1)
        crops = [self.images[v, :, y : y + rows, x : x + columns] for v, y, x in zip(views, tops, lefts, strict=True)]
        batch = torch.stack(crops).contiguous()
        if self.config.augment:
            turn = int(torch.randint(8, (1,), generator=self.places))
            if self.cfa is not None:
                return turned(batch, turn, self.cfa)
            batch = torch.rot90(batch, turn % 4, (2, 3))
            batch = batch.flip(3) if turn >= 4 else batch
        return batch

    def _integers(self, high: int) -> list[int]:
        return [int(i) for i in torch.randint(high, (self.config.batch,), generator=self.places)]

    def state(self) -> dict[str, Tensor]:
        """Everything the next step depends on, except the images: weights, Adam moments, step and random state."""
        own = {"denoiser.generator": self.generator.get_state(), "denoiser.steps": torch.tensor(self.step)}
        if self.places is not self.generator:
            own["denoiser.places"] = self.places.get_state()
        return pack("denoiser", self.network, self.optimizer) | own

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state`.

        Raises:
            ValueError: If it belongs to a network of another shape, or is damaged.
        """
        unpack("denoiser", tensors, self.network, self.optimizer)
        steps, state = tensors.get("denoiser.steps"), tensors.get("denoiser.generator")
        like = self.generator.get_state()
        if state is None or state.shape != like.shape or state.dtype != like.dtype:
            raise ValueError("the checkpoint lacks the denoiser's random state: delete it, the run then starts over")
        if steps is None or steps.shape != () or not 0 <= (done := int(steps)) <= self.total_steps:
            raise ValueError(
                f"the checkpoint's denoiser must have done 0 to {self.total_steps} steps: delete it, the run then "
                "starts over"
            )
        self.generator.set_state(state.cpu())
        if self.places is not self.generator:
            places = tensors.get("denoiser.places")
            if places is None or places.shape != self.places.get_state().shape or places.dtype != like.dtype:
                raise ValueError("the checkpoint is of a run on a CPU: delete it, the run then starts over")
            self.places.set_state(places.cpu())
        self.step = done
