"""Deep Attention-ResUNet, the denoiser's network (paper, section 4.3.2; supplement, section B.3).

Images are [B, D, H, W] of any size; the network works on sizes padded to a multiple of 2**levels. Its maps have the
channels of a pixel beside each other in memory (channels last), from the first layer to the last and on the way back:
the layout in which convolutions on a CPU are fastest, and a third of a step were copies to another one and back.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from novags.methods.memory import MANY
from novags.methods.nova.denoiser_config import ResUNetConfig
from novags.methods.nova.layers.normalise import CONSTANT, EPS, normalised

FEW = 128  # pixels, those of all images of a batch together


class InstanceNorm(nn.InstanceNorm2d):
    """Instance normalisation without parameters, and LeakyReLU; a map that is constant up to rounding becomes 0.

    Such a map has no slope either. Divided by its own deviation, as any other, it would be its rounding errors times
    316 (1 / sqrt(eps)). Some layers of that turn a black view into noise of order one, and its gradients into
    infinities.
    """

    def __init__(self, channels: int, slope: float) -> None:
        """slope: of the rectifier below zero; 1 for none."""
        super().__init__(channels, eps=EPS)
        self.slope = slope

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, D, H, W], normalised per image and channel."""
        if x.device.type == "cpu" and x.dtype != torch.float64:
            return normalised(x, self.slope)
        return self.plain(x)

    def plain(self, x: Tensor) -> Tensor:
        """The same by torch's operators, on any device."""
        low, high = x.detach().amin((2, 3), keepdim=True), x.detach().amax((2, 3), keepdim=True)
        constant = high - low <= CONSTANT * (1 + high.abs())
        return F.leaky_relu(torch.where(constant, 0.0, super().forward(x)), self.slope)


class Convolution(nn.Module):
    """A convolution in the precision of its input; its kernels are in float32.

    They lie as convolutions want them, [channels_out, edge, edge, channels_in]: torch's fused Adam takes 2.5 times as
    long for the same memory under torch's own order of axes.
    """

    def __init__(self, channels_in: int, channels_out: int, edge: int) -> None:
        """edge: of the kernel, 1 or 3; images are continued by reflection."""
        super().__init__()
        first = nn.Conv2d(channels_in, channels_out, edge)
        assert first.bias is not None
        self.in_channels, self.out_channels, self.edge = channels_in, channels_out, edge
        self.weight, self.bias = nn.Parameter(first.weight.detach().movedim(1, -1).contiguous()), first.bias

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, channels_in, H, W]."""
        if x.device.type != "cpu" or x.numel() > FEW * self.in_channels:
            return self.plain(x)
        # Few pixels have fewer values than the kernels, which a convolution brings into an order of its own and their
        # gradients back; a product of matrices takes them as they are.
        (height, width), wide = x.shape[-2:], self._continued(x).movedim(1, -1)
        taps = [wide[:, i : i + height, j : j + width] for i in range(self.edge) for j in range(self.edge)]
        return F.linear(torch.cat(taps, -1), self.weight.to(x.dtype).flatten(1), self.bias.to(x.dtype)).movedim(-1, 1)

    def plain(self, x: Tensor) -> Tensor:
        """The same by torch's convolution, for any number of pixels, on any device."""
        return F.conv2d(self._continued(x), self.weight.to(x.dtype).movedim(-1, 1), self.bias.to(x.dtype))

    def _continued(self, x: Tensor) -> Tensor:
        return F.pad(x, (self.edge // 2,) * 4, mode="reflect") if self.edge > 1 else x


class _GlobalMean(torch.autograd.Function):
    """Mean over the pixels of x [B, D, H, W], [B, D, 1, 1], whose slope takes no room: torch writes it out, slowly."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.shape = x.shape
        return x.mean((2, 3), keepdim=True)

    @staticmethod
    def backward(ctx: Any, slope: Tensor) -> Tensor:
        return (slope / (ctx.shape[2] * ctx.shape[3])).expand(ctx.shape)


class _Twice(torch.autograd.Function):
    """x [B, D, H, W] enlarged to 2 H and 2 W by bilinear interpolation.

    Its slope comes as a part of more channels, which torch would take for maps one after the other: ten times slower.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.shape = x.shape
        return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)

    @staticmethod
    def backward(ctx: Any, slope: Tensor) -> Tensor:
        back, whole = torch.ops.aten.upsample_bilinear2d_backward, slope.contiguous(memory_format=torch.channels_last)
        found: Tensor = back(whole, slope.shape[2:], ctx.shape, False)
        return found


class GlobalMean(nn.Module):
    """Global average pooling."""

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, D, H, W] to [B, D, 1, 1]."""
        return _GlobalMean.apply(x)


def _conv(channels_in: int, channels: int, kind: str, slope: float) -> list[nn.Module]:
    """3 x 3 convolution, normalisation, LeakyReLU."""
    rectifier = nn.LeakyReLU(slope, inplace=True) if slope != 1 else nn.Identity()
    return [Convolution(channels_in, channels, 3), InstanceNorm(channels, slope) if kind == "instance" else rectifier]


class SqueezeExcite(nn.Module):
    """Channel gate from global means: adaptive average pool, reduction, ReLU, sigmoid (Hu et al. 2018)."""

    def __init__(self, channels: int, reduction: int) -> None:
        super().__init__()
        hidden = max(1, channels // reduction)
        self.gate = nn.Sequential(
            GlobalMean(),
            Convolution(channels, hidden, 1),
            nn.ReLU(),
            Convolution(hidden, channels, 1),
            nn.Sigmoid(),
        )

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, D, H, W], returned scaled per channel."""
        return x * self.gate(x)


class GatedLevel(nn.Module):
    """One encoder or decoder level: convolution with LeakyReLU(0.2), then a ResBlock gated before its addition.

    With `blocks="plain"`: two such convolutions.
    """

    def __init__(self, channels_in: int, channels: int, config: ResUNetConfig) -> None:
        super().__init__()
        kind = config.normalization
        self.enter = nn.Sequential(*_conv(channels_in, channels, kind, 0.2))
        self.plain = config.blocks == "plain"
        if self.plain:
            self.second = nn.Sequential(*_conv(channels, channels, kind, 0.2))
            return
        self.residual = nn.Sequential(
            *_conv(channels, channels, kind, 0.2), nn.Identity(),  # checkpoints count as when the rectifier stood here
            *_conv(channels, channels, kind, 1.0), SqueezeExcite(channels, config.se_reduction),
        )  # fmt: skip

    def forward(self, x: Tensor, large: bool = False) -> Tensor:
        """x: [B, channels_in, H, W] to [B, channels, H, W]; `large`: whether parts of it keep their inputs alone."""
        x = _forgetting(large, self.enter, x)
        if self.plain:
            return _forgetting(large, self.second, x)
        half = len(self.residual) // 2
        between = _forgetting(large, self.residual[:half], x)
        return _forgetting(large, lambda a, b: F.leaky_relu_(a + self.residual[half:](b), 0.2), x, between)


def _forgetting(large: bool, part: Callable[..., Tensor], *inputs: Tensor) -> Tensor:
    """The result of a part of the network, which keeps its inputs alone where images are `large`.

    A step would otherwise hold 10 kB for each pixel until its gradients are made. What a part needs for its own is
    computed again, with the same bits.
    """
    if not large or not torch.is_grad_enabled():
        return part(*inputs)
    found: Tensor = checkpoint(part, *inputs, use_reentrant=False, preserve_rng_state=False)
    return found


class ResUNet(nn.Module):
    """Encoder, bottleneck, and a symmetric decoder with concatenated skip connections."""

    def __init__(self, config: ResUNetConfig | None = None, channels: int = 3) -> None:
        """channels: D of the images, 4 of packed mosaics."""
        super().__init__()
        self.config = config or ResUNetConfig()
        inputs = (channels, *self.config.widths)
        self.encoder = nn.ModuleList(
            GatedLevel(a, b, self.config) for a, b in zip(inputs[:-1], inputs[1:], strict=True)
        )
        self.bottleneck = GatedLevel(inputs[-1], self.config.bottleneck, self.config)
        below = (*self.config.widths[1:], self.config.bottleneck)
        self.reduce = nn.ModuleList(Convolution(b, a, 1) for a, b in zip(self.config.widths, below, strict=True))
        self.decoder = nn.ModuleList(GatedLevel(2 * a, a, self.config) for a in self.config.widths)
        self.head = Convolution(self.config.widths[0], channels, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Denoise images.

        Args:
            images: [B, D, H, W] float32, at least 1 px on each side.

        Returns:
            [B, D, H, W] float32, not clipped.
        """
        height, width = images.shape[-2:]
        large = images.device.type == "cpu" and height * width >= MANY
        multiple = 2 ** len(self.encoder)
        # Two px at the bottleneck: reflection by one pixel does not exist in an image of one.
        down = max(2 * multiple, -(-height // multiple) * multiple) - height
        right = max(2 * multiple, -(-width // multiple) * multiple) - width
        mode = "reflect" if down < height and right < width else "replicate"
        x = F.pad(images, (0, right, 0, down), mode=mode) if down or right else images
        x = x.contiguous(memory_format=torch.channels_last)
        x = self._run(x.bfloat16() if self.config.precision == "bfloat16" else x, large)
        return x[..., :height, :width].to(images.dtype)

    def _run(self, x: Tensor, large: bool) -> Tensor:
        skips: list[Tensor] = []
        for level in self.encoder:
            x = _forgetting(large, partial(_descended if skips else _entered, level, large), x)
            skips.append(x)
        x = _forgetting(large, partial(_descended, self.bottleneck, large), x)
        for reduce, level, skip in zip(self.reduce[::-1], self.decoder[::-1], skips[::-1], strict=True):
            x = _forgetting(large, partial(_ascended, reduce, level, large), skip, x)
        return self.head(x)


def _entered(level: nn.Module, large: bool, x: Tensor) -> Tensor:
    found: Tensor = level(x, large)
    return found


def _descended(level: nn.Module, large: bool, x: Tensor) -> Tensor:
    """The level below."""
    return _entered(level, large, F.max_pool2d(x, 2))


def _ascended(reduce: nn.Module, level: nn.Module, large: bool, skip: Tensor, x: Tensor) -> Tensor:
    """The level above, which sees the encoder's maps of its size."""
    # The paper enlarges first. Both are linear and the weights of a pixel add up to one, so this is the same, with a
    # quarter of the pixels to reduce and half of the channels to enlarge.
    return _entered(level, large, torch.cat([_Twice.apply(reduce(x)), skip], 1))
