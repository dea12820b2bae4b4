"""Hard cases of the denoiser: constant views, views of any size, one electron, half of the digits.

The reference is the network written out as functions of its weights, in float64, with means and variances taken in two
passes; a constant map is normalised to 0, as in exact arithmetic.
"""

import math
from typing import Literal

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.nova.blindspot import n2v_loss, sample_mask
from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import FAST_DENOISER, BlindSpotConfig, DenoiserConfig, ResUNetConfig
from novags.methods.nova.resunet import InstanceNorm, ResUNet
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, relative_error, worst_error

PART = Part("denoiser")

# 27 normalised layers in a row. Each adds some roundings, and a normalisation hands on relative errors as they are; max
# pooling and rectifiers have slopes that jump where two values are as good as equal.
LAYERS = 1e-4
PAPER = ResUNetConfig(widths=(4, 8, 16, 32), bottleneck=32)
SMALL = ResUNetConfig(widths=(8, 16), bottleneck=16, normalization="none")


class _WrittenOut:
    """The network of `weights` (by name) on images [B, 3, H, W], float64."""

    def __init__(self, weights: dict[str, Tensor], levels: int, normalise: bool) -> None:
        self.weights, self.levels, self.normalise = weights, levels, normalise

    def conv(self, name: str, x: Tensor) -> Tensor:
        kernel, bias = self.weights[f"{name}.weight"].movedim(-1, 1), self.weights[f"{name}.bias"]
        if kernel.shape[-1] == 3:
            x = F.pad(x, (1, 1, 1, 1), mode="reflect")
        # a sum over shifted images instead of a convolution
        height, width = x.shape[-2] - kernel.shape[-2] + 1, x.shape[-1] - kernel.shape[-1] + 1
        taps = [(i, j) for i in range(kernel.shape[-2]) for j in range(kernel.shape[-1])]
        shifted = (torch.einsum("od,bdhw->bohw", kernel[:, :, i, j], x[..., i : i + height, j : j + width])
                   for i, j in taps)  # fmt: skip
        return sum(shifted, bias[:, None, None])

    def norm(self, x: Tensor) -> Tensor:
        if not self.normalise:
            return x
        centred = x - x.mean((2, 3), keepdim=True)
        variance = centred.square().mean((2, 3), keepdim=True)
        return torch.where(variance < 1e-14, 0.0, centred / torch.sqrt(variance + 1e-5))

    def level(self, name: str, x: Tensor) -> Tensor:
        x = torch.where((y := self.norm(self.conv(f"{name}.enter.0", x))) > 0, y, 0.2 * y)
        z = self.norm(self.conv(f"{name}.residual.0", x))
        z = self.norm(self.conv(f"{name}.residual.3", torch.where(z > 0, z, 0.2 * z)))
        hidden = self.conv(f"{name}.residual.5.gate.1", z.mean((2, 3), keepdim=True)).clamp_min(0)
        y = x + z / (1 + torch.exp(-self.conv(f"{name}.residual.5.gate.3", hidden)))
        return torch.where(y > 0, y, 0.2 * y)

    def __call__(self, images: Tensor) -> Tensor:
        height, width = images.shape[-2:]
        multiple = 2**self.levels
        goal = [max(2 * multiple, multiple * math.ceil(side / multiple)) for side in (height, width)]
        mode = "reflect" if all(g - s < s for g, s in zip(goal, (height, width), strict=True)) else "replicate"
        x = F.pad(images, (0, goal[1] - width, 0, goal[0] - height), mode=mode)
        skips: list[Tensor] = []
        for i in range(self.levels):
            skips.append(self.level(f"encoder.{i}", x if not i else F.max_pool2d(skips[-1], 2)))
        x = self.level("bottleneck", F.max_pool2d(skips[-1], 2))
        for i in reversed(range(self.levels)):
            up = F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
            x = self.level(f"decoder.{i}", torch.cat([self.conv(f"reduce.{i}", up), skips[i]], 1))
        return self.conv("head", x)[..., :height, :width]


def _stream(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def _error(images: Tensor, config: ResUNetConfig, share: float = 0.3) -> float:
    """Error of the prediction, and of the blind-spot loss's gradient in all weights together."""
    torch.manual_seed(0)
    network = ResUNet(config)
    mask = sample_mask(images, share, 0.0, _stream())
    found = network(images)
    n2v_loss(found, images, mask).backward()
    weights = {name: p.detach().double().requires_grad_() for name, p in network.named_parameters()}
    wanted = _WrittenOut(weights, len(config.widths), config.normalization == "instance")(images.double())
    n2v_loss(wanted, images.double(), mask).backward()
    slopes = torch.cat([p.grad.flatten() for p in network.parameters() if p.grad is not None])
    exact = torch.cat([p.grad.flatten() for p in weights.values() if p.grad is not None])
    return worst_error([(found, wanted), (slopes, exact)])


@PART.case("constant views: nothing for instance normalisation to divide by", bound=LAYERS, unit=LARGEST)
def constant(setting: Setting) -> float:
    """Rounding noise would grow 316-fold a layer, and gradients as much on their way back."""
    views = [torch.full((1, 3, 32, 32), level) for level in (0.0, 1 / 255, 0.3, 1.0)]
    colored = torch.tensor([0.2, 0.5, 0.9])[:, None, None].expand(1, 3, 24, 40).contiguous()
    return max(_error(view, PAPER) for view in (*views, colored))


@PART.case("one pixel one 8-bit step above a constant view", bound=5e-3, unit=LARGEST)
def nearly_constant(setting: Setting) -> float:
    """A first map is 0.5 with a bump of some 1e-4; a rounding of 0.5 is 1e-3 of that, and normalised with it."""
    view = torch.full((1, 3, 32, 32), 0.5)
    view[0, 1, 13, 7] += 1 / 255
    return _error(view, PAPER)


@PART.case("maps of one pixel, sizes that 16 does not divide", bound=2e-3, unit=LARGEST)
def any_size(setting: Setting) -> float:
    """With and without normalisation. Repeated borders make a bottleneck of 2 x 2 pixels that hardly differ.

    Of an image of 2 x 1 pixels they differ by roundings alone, and normalised are noise in any layout.
    """
    cases = [((3, 2), PAPER), ((5, 3), PAPER), ((17, 23), PAPER), ((1, 2), SMALL), ((9, 21), SMALL)]
    return max(_error(torch.rand(1, 3, *size, generator=_stream()), config, 0.5) for size, config in cases)


def one_electron(views: int, size: int) -> Tensor:
    """Views [C, H, W, 3] of a ramp at a mean of one electron, brightened to a mean of one half: most pixels are 0."""
    rng = np.random.default_rng(0)
    mean = np.linspace(0.2, 1.8, size)[None, None, :, None] * np.ones((views, size, size, 3))
    return torch.from_numpy(np.clip(rng.poisson(mean) / 2.0, 0, 1).astype(np.float32))


@PART.case("one electron", bound=LAYERS, unit=LARGEST)
def at_one_electron(setting: Setting) -> float:
    """Pictures of three codes."""
    images = one_electron(1, 32).movedim(-1, 1)
    return max(_error(images, config) for config in (PAPER, SMALL))


@PART.case("one electron: five training steps", bound=20 * EPS, unit="of the loss")
def trained_at_one_electron(setting: Setting) -> float:
    """The losses of steps in float32 beside those of the same steps in float64: sums of some hundred squares."""
    config = DenoiserConfig(network=SMALL, blind_spots=BlindSpotConfig(laplacian_share=0.5), batch=2, crop=12)
    pair = [Denoiser(one_electron(3, 16), config, total_steps=5, seed=0) for _ in range(2)]
    pair[1].network.double()
    pair[1].images = pair[1].images.double()
    pair[1].predict = _WrittenOut(dict(pair[1].network.named_parameters()), 2, False)
    losses = [[denoiser.train_step() for _ in range(5)] for denoiser in pair]
    return relative_error(losses[0], losses[1])


def _final_loss(precision: Literal["float32", "bfloat16"], steps: int) -> float:
    network = ResUNetConfig(widths=(8, 16), bottleneck=16, normalization="none", precision=precision)
    config = DenoiserConfig(
        network=network, blind_spots=FAST_DENOISER.blind_spots, batch=2, crop=16, learning_rate=1.5e-3, decay="cosine",
        augment=True, residual_blur=0.8,
    )  # fmt: skip
    denoiser = Denoiser(one_electron(4, 24), config, total_steps=steps, seed=0)
    losses = [denoiser.train_step() for _ in range(steps)]
    ends = [float(p.detach().abs().max()) for p in denoiser.network.parameters()]
    return float(np.mean(losses[-steps // 4 :])) if np.isfinite(ends).all() else math.inf


@PART.case("bfloat16 against float32 over 1,000 steps", bound=5e-3, unit="of the loss", slow=True)
def bfloat16(setting: Setting) -> float:
    """The mean loss of the last 250 steps, at one electron and the same draws.

    A bfloat16 has eight bits: a prediction near 1/2 is off by 1/500, whose square is nothing beside the noise. What
    remains is that training takes another path; the loss at its end must not show it.
    """
    wanted = _final_loss("float32", 1000)
    return relative_error(_final_loss("bfloat16", 1000), wanted)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_normalised_rounding_noise_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = nn.InstanceNorm2d.forward
    monkeypatch.setattr(InstanceNorm, "forward", lambda self, x: F.leaky_relu(bare(self, x), self.slope))
    assert fails("constant views: nothing for instance normalisation to divide by")


def test_the_guard_of_constant_maps_changes_no_bit_of_others() -> None:
    x = torch.randn(2, 5, 7, 9, generator=torch.Generator().manual_seed(0))
    pair = [x.clone().requires_grad_() for _ in range(2)]
    found = [norm(y) for norm, y in zip((InstanceNorm(5, 1.0).plain, nn.InstanceNorm2d(5)), pair, strict=True)]
    for y in found:
        (y * torch.linspace(-1, 1, 9)).sum().backward()
    assert torch.equal(*found)
    assert torch.equal(pair[0].grad, pair[1].grad)


def test_a_wrong_slope_of_the_rectifier_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    leaky = nn.LeakyReLU.forward
    monkeypatch.setattr(nn.LeakyReLU, "forward", lambda self, x: leaky(self, x) * (1 + 1e-3))
    assert fails("one electron")
    assert fails("one electron: five training steps")
