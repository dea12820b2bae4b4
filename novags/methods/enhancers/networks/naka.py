"""Naka-GS's tone mapping and the network that corrects it (arXiv 2604.11142).

The response of `curves/naka.py` raises the picture; a U-Net of three levels sees both pictures and their difference,
each also with mean 0 and deviation 1, and gives a factor and a summand of every pixel. They correct the blurred part of
the raised picture alone: its details are added again unchanged. Widths, ranges and layers are as published, and the
layers have the names of the authors' code (Apache-2.0), so that their files fit.

Deviations: it learns from pairs of our cameras by our loss, as the published loss compares features of VGG-19, whose
weights are not here. The published program limits the response by a percentile of 99.9; here its least and largest
value become 0 and 1. It does not learn from a scene: it needs pairs.
"""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.enhancers.networks.kind import Kind
from novags.methods.enhancers.networks.rows.naka_net import NakaNetConfig

HALF = 0.05  # code that becomes one half before the stretch; weights are learnt for one value
WIDTH = 32  # channels at full size, doubled at every level
FACTOR, SUMMAND = 0.6, 0.25  # largest change of the factor from 1, and largest summand
BLUR, SIGMA = 5, 1.0  # px
GROUPS = 8  # of channels that are normalised together
# A flat picture has no deviation, and none of its pixels would be finite.
FLAT = 1e-4


class Convolved(nn.Module):
    """A convolution, normalised over groups of channels, and GELU unless a sum follows."""

    def __init__(self, inputs: int, outputs: int, *, stride: int = 1, bent: bool = True) -> None:
        super().__init__()
        layers = [nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False), nn.GroupNorm(GROUPS, outputs)]
        self.block = nn.Sequential(*layers, *([nn.GELU()] if bent else []))

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, inputs, H, W] -> [B, outputs, H, W], or half of H and W, rounded up."""
        found: Tensor = self.block(x)
        return found


class Residual(nn.Module):
    """Two convolutions, added to what goes in."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv1, self.conv2 = Convolved(width, width), Convolved(width, width, bent=False)

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, width, H, W] -> the same shape."""
        return F.gelu(self.conv2(self.conv1(x)) + x)


class Weighed(nn.Module):
    """Every channel times a weight in 0..1, from the means of all channels (squeeze and excitation)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        middle = max(8, width // 8)
        self.fc = nn.Sequential(nn.Conv2d(width, middle, 1), nn.GELU(), nn.Conv2d(middle, width, 1), nn.Sigmoid())

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, width, H, W] -> the same shape."""
        return x * self.fc(x.mean((2, 3), keepdim=True))


class Down(nn.Module):
    """A level on the way down."""

    def __init__(self, inputs: int, outputs: int, blocks: int) -> None:
        super().__init__()
        residuals = [Residual(outputs) for _ in range(blocks)]
        self.block = nn.Sequential(Convolved(inputs, outputs), *residuals, Weighed(outputs))
        self.down = Convolved(outputs, outputs, stride=2)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """x: [B, inputs, H, W] -> features [B, outputs, H, W], and their convolution at half the size."""
        found = self.block(x)
        return found, self.down(found)


class Up(nn.Module):
    """A level on the way up."""

    def __init__(self, below: int, beside: int, outputs: int) -> None:
        super().__init__()
        self.reduce = Convolved(below + beside, outputs)
        self.block = nn.Sequential(Residual(outputs), Residual(outputs), Weighed(outputs))

    def forward(self, below: Tensor, beside: Tensor) -> Tensor:
        """Features of the level below, enlarged, and of the same level on the way down -> [B, outputs, H, W]."""
        enlarged = F.interpolate(below, size=beside.shape[-2:], mode="bilinear", align_corners=False)
        found: Tensor = self.block(self.reduce(torch.cat([enlarged, beside], 1)))
        return found


class Correction(nn.Module):
    """The network."""

    def __init__(self, width: int = WIDTH) -> None:
        super().__init__()
        self.stem = Convolved(18, width)
        self.down1, self.down2, self.down3 = (
            Down(width, width, 2),
            Down(width, 2 * width, 2),
            Down(2 * width, 4 * width, 3),
        )
        deepest = [Residual(8 * width), Residual(8 * width), Weighed(8 * width)]
        self.bottleneck = nn.Sequential(Convolved(4 * width, 8 * width), *deepest)
        self.up3, self.up2 = Up(8 * width, 4 * width, 4 * width), Up(4 * width, 2 * width, 2 * width)
        self.up1 = Up(2 * width, width, width)
        self.fuse = nn.Sequential(Convolved(width, width), Residual(width))
        self.mul_head, self.add_head = nn.Conv2d(width, 1, 3, padding=1), nn.Conv2d(width, 3, 3, padding=1)

    def forward(self, dark: Tensor) -> Tensor:
        """dark: [B, 3, H, W], code in 0..1 -> the same shape; not limited to 0..1."""
        raised = response(dark)
        seen = [dark, raised, raised - dark]
        x = self.stem(torch.cat([*seen, *map(even, seen)], 1))
        kept = []
        for level in (self.down1, self.down2, self.down3):
            found, x = level(x)
            kept.append(found)
        x = self.bottleneck(x)
        for up, beside in zip((self.up3, self.up2, self.up1), reversed(kept), strict=True):
            x = up(x, beside)
        x = self.fuse(x)
        factor, summand = 1 + FACTOR * self.mul_head(x).tanh(), SUMMAND * self.add_head(x).tanh()
        smooth = blurred(raised)
        return smooth * factor + summand + (raised - smooth)


def response(dark: Tensor) -> Tensor:
    """`curves/naka.py` on pictures [B, 3, H, W], with a slope."""
    found = dark / (dark + HALF)
    low, high = found.amin((1, 2, 3), keepdim=True), found.amax((1, 2, 3), keepdim=True)
    # One colour all over has no range to be stretched.
    return torch.where(high > low, (found - low) / torch.where(high > low, high - low, torch.inf), dark)


def even(x: Tensor) -> Tensor:
    """Every channel of every picture with mean 0 and deviation 1."""
    mean, deviation = x.mean((2, 3), keepdim=True), x.std((2, 3), keepdim=True, unbiased=False)
    return (x - mean) / deviation.clamp_min(FLAT)


def blurred(x: Tensor) -> Tensor:
    """[B, 3, H, W] with a Gaussian of 5 x 5 px; black lies around it, as published."""
    places = torch.arange(BLUR, dtype=x.dtype, device=x.device) - BLUR // 2
    line = (-places.square() / (2 * SIGMA**2)).exp()
    line = line / line.sum()
    across = F.conv2d(x, line.expand(3, 1, 1, BLUR), padding=(0, BLUR // 2), groups=3)
    return F.conv2d(across, line[:, None].expand(3, 1, BLUR, 1), padding=(BLUR // 2, 0), groups=3)


def of_the_authors(tensors: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
    """Tensors of an official file under the names of this network. Older files have a factor for each channel, and
    their mean is taken, as the authors' program does.
    """
    found = {name.removeprefix("model."): value for name, value in tensors.items()}
    for name in ("mul_head.weight", "mul_head.bias"):
        if name in found and len(found[name]) == 3:
            found[name] = found[name].mean(0, keepdim=True)
    return found


def run(network: nn.Module, picture: Tensor, config: NakaNetConfig) -> Tensor:
    """A picture [B, 3, H, W] of any size through the network."""
    bright: Tensor = network(picture)
    return bright


NAKA_NET = Kind(
    name="Naka-GS", make=lambda config: Correction(), run=run, renamed=of_the_authors,
    where="the authors' best.pth, or a file of the same network, trained here",
)  # fmt: skip
enhance = NAKA_NET.enhance
