"""Zero-DCE (Guo et al. 2020, "Zero-Reference Deep Curve Estimation for Low-Light Image Enhancement").

A network of seven convolutions gives eight maps A of every pixel's colours; the picture goes through eight curves
x <- x + A (x² - x), which keep 0 and 1. With A in -1..0 a curve brightens. It learns without references, from four
losses on its own result.

Stated in the authors' code and different from the paper, taken from the code: the weights of the losses, the squared
distance of the exposure loss, the sign of the slopes in the spatial loss, and A (x² - x) where the paper has
A x (1 - x), which is the same curve of -A.

Deviations: it learns from random crops of the scene's own pictures instead of 2422 pictures of the SICE set, in fewer
steps; patches shrink to fit small pictures; the spatial loss has no slopes over the border, where the code pads with 0.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.optim import Adam

from novags.methods.enhancers.networks.kind import Kind, Rehearsal
from novags.methods.enhancers.networks.rows.zero_dce import ZeroDceConfig
from novags.methods.enhancers.pictures import exposure, pooled

CURVES = 8
REGION = 4  # px, of the spatial loss
SMOOTH, COLOR, EXPOSED = 200.0, 5.0, 10.0  # weights beside the spatial loss


class ZeroDce(nn.Module):
    """The network DCE-Net; names of its layers as in the official file."""

    def __init__(self) -> None:
        super().__init__()
        inputs = (3, 32, 32, 32, 64, 64, 64)
        for i, width in enumerate(inputs, 1):
            layer = nn.Conv2d(width, 32 if i < 7 else 3 * CURVES, 3, padding=1)
            nn.init.normal_(layer.weight, 0.0, 0.02)
            self.add_module(f"e_conv{i}", layer)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """x: [B, 3, H, W] in 0..1 -> the enhanced pictures, the same shape, and the maps A [B, 24, H, W]."""
        layers = [self.get_submodule(f"e_conv{i}") for i in range(1, 8)]
        seen = [x]
        for layer in layers[:4]:
            seen.append(F.relu(layer(seen[-1])))
        fifth = F.relu(layers[4](torch.cat([seen[3], seen[4]], 1)))
        sixth = F.relu(layers[5](torch.cat([seen[2], fifth], 1)))
        maps = torch.tanh(layers[6](torch.cat([seen[1], sixth], 1)))
        for curve in maps.split(3, 1):
            x = x + curve * (x * x - x)
        return x, maps


def smoothness(maps: Tensor) -> Tensor:
    """Twice the mean square of the differences of maps [B, D, H, W] along rows and columns, summed over D."""
    rows, columns = (maps.diff(dim=d).square() for d in (2, 3))
    per_map = [2 * part.sum() / max(1, part[0, 0].numel()) for part in (rows, columns)]
    return (per_map[0] + per_map[1]) / len(maps)


def constancy(bright: Tensor) -> Tensor:
    """The mean colour of a picture should be grey: root of the sum of the fourth powers of channel differences."""
    red, green, blue = bright.mean((2, 3)).unbind(1)
    powers = (red - green) ** 4 + (red - blue) ** 4 + (green - blue) ** 4
    # Without the floor the root of a grey picture has an infinite slope, and 0 times that is NaN.
    return powers.clamp_min(1e-24).sqrt().mean()


def spatial(dark: Tensor, bright: Tensor) -> Tensor:
    """Slopes between neighbouring regions should stay: mean over regions of the sum over four neighbours."""
    change = pooled(bright, REGION) - pooled(dark, REGION)
    # Each slope has two regions, and counts in both.
    steps = [2 * change.diff(dim=d).square().sum() for d in (2, 3)]
    return (steps[0] + steps[1]) / change.numel()


def loss(network: nn.Module, dark: Tensor, config: ZeroDceConfig) -> Tensor:
    """The four losses, weighted as published."""
    bright, maps = network(dark)
    return SMOOTH * smoothness(maps) + spatial(dark, bright) + COLOR * constancy(bright) + EXPOSED * exposure(bright)


def _optimizer(network: nn.Module, config: ZeroDceConfig) -> Adam:
    return Adam(network.parameters(), lr=config.rate, weight_decay=config.decay)


ZERO_DCE = Kind(
    name="Zero-DCE",
    make=lambda config: ZeroDce(),
    run=lambda network, picture, config: network(picture)[0],
    rehearsal=Rehearsal(
        loss=loss, steps=lambda config: config.steps, optimizer=_optimizer, clip=0.1,
        batch=lambda config: (config.batch, config.crop),
    ),
    where="the authors' Epoch99.pth",
)  # fmt: skip
enhance = ZERO_DCE.enhance
