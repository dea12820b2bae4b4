"""SCI (Ma et al. 2022, "Toward Fast, Flexible, and Robust Low-Light Image Enhancement") and its successor SCI++.

A small network H estimates the illumination i of a picture x, i = x + H(x), and the picture becomes x / i. It learns
without references: H is applied in three stages with the same weights, and a second network K, the self-calibrator,
brings each stage's result back to an input of the next, x' = y + (r - K(r)). Where the stages agree, one is enough:
only H's first stage is used afterwards.

SCI++ (Ma et al. 2025, IEEE TPAMI 47, 10) adds "the additivity condition on the basic block", which "disentangles the
relationship between the self-calibrator and illumination estimator". No code of it is public, and no formula of the
condition was found. `additivity` is this project's reading: with s the calibrator's addition to y, the mean square of
H(y + s) - H(y) - H(s), a penalty in every stage after the first. It is 0, that is SCI, unless it is set.

Deviations: it learns from random crops of the scene's own pictures, in fewer steps; official weights keep H with the
statistics of its batch normalisation, which hold for whole pictures. The smoothness weighs colours by BT.601. The
authors' code has 0.564 instead of 0.504 of green and takes three neighbours in a row of one channel for the three
channels of a pixel. For pictures in 0..1 every weight is 0.99 to 1 either way. Biases of convolutions begin as torch
draws them, there at 0.
"""

import torch
from torch import Tensor, nn
from torch.optim import Adam

from novags.methods.enhancers.networks.kind import Kind, Rehearsal
from novags.methods.enhancers.networks.rows.sci import SciConfig

STAGES = 3
DARKEST = 1e-4  # of an illumination: 0 / 0 in black pixels without it
FIDELITY = 1.5
RADIUS, SPREAD = 2, 200.0  # px around a pixel whose illumination is to be alike; twice the variance of their colours


def _conv(inputs: int, outputs: int) -> nn.Conv2d:
    layer = nn.Conv2d(inputs, outputs, 3, padding=1)
    nn.init.normal_(layer.weight, 0.0, 0.02)
    return layer


def _norm(width: int) -> nn.BatchNorm2d:
    layer = nn.BatchNorm2d(width)
    nn.init.normal_(layer.weight, 1.0, 0.02)
    return layer


class Illumination(nn.Module):
    """H with the identity beside it: x [B, 3, H, W] -> i in 1e-4..1."""

    def __init__(self, width: int = 3, blocks: int = 1) -> None:
        super().__init__()
        self.in_conv = nn.Sequential(_conv(3, width), nn.ReLU())
        self.conv = nn.Sequential(_conv(width, width), _norm(width), nn.ReLU())
        self.blocks = nn.ModuleList([self.conv] * blocks)  # the same block, under both names as in official files
        self.out_conv = nn.Sequential(_conv(width, 3), nn.Sigmoid())

    def added(self, x: Tensor) -> Tensor:
        """H(x), the difference between illumination and picture."""
        seen = self.in_conv(x)
        for block in self.blocks:
            seen = seen + block(seen)
        out: Tensor = self.out_conv(seen)
        return out

    def forward(self, x: Tensor) -> Tensor:
        """The illumination."""
        return (self.added(x) + x).clamp(DARKEST, 1)


class Calibrator(nn.Module):
    """r - K(r)."""

    def __init__(self, width: int = 16, blocks: int = 3) -> None:
        super().__init__()
        self.in_conv = nn.Sequential(_conv(3, width), _norm(width), nn.ReLU())
        self.convs = nn.Sequential(
            _conv(width, width), _norm(width), nn.ReLU(), _conv(width, width), _norm(width), nn.ReLU()
        )
        self.blocks = nn.ModuleList([self.convs] * blocks)
        self.out_conv = nn.Sequential(_conv(width, 3), nn.Sigmoid())

    def forward(self, r: Tensor) -> Tensor:
        """The summand for the picture: [B, 3, H, W]."""
        seen = self.in_conv(r)
        for block in self.blocks:
            seen = seen + block(seen)
        return r - self.out_conv(seen)


class Sci(nn.Module):
    """Both networks."""

    def __init__(self) -> None:
        super().__init__()
        self.enhance, self.calibrate = Illumination(), Calibrator()

    def forward(self, x: Tensor) -> Tensor:
        """A picture divided by its illumination, [B, 3, H, W] in 0..1."""
        return (x / self.enhance(x)).clamp(0, 1)

    def stages(self, y: Tensor) -> list[tuple[Tensor, Tensor, Tensor]]:
        """The calibrator's addition s of every stage, the input x = y + s, and its illumination."""
        found, s = [], torch.zeros_like(y)
        for _ in range(STAGES):
            x = y + s
            light = self.enhance(x)
            found.append((s, x, light))
            s = self.calibrate((y / light).clamp(0, 1))
        return found


def to_ycbcr(rgb: Tensor) -> Tensor:
    """[B, 3, H, W] in 0..1 -> Y, Cb, Cr of BT.601 in 0..1."""
    matrix = rgb.new_tensor([[0.257, 0.504, 0.098], [-0.148, -0.291, 0.439], [0.439, -0.368, -0.071]])
    offset = rgb.new_tensor([16.0, 128.0, 128.0]) / 255
    return torch.einsum("cd,bdhw->bchw", matrix, rgb) + offset[:, None, None]


def smoothness(x: Tensor, light: Tensor) -> Tensor:
    """Light [B, 3, H, W] should be alike where the picture x is: sum over 24 neighbours of means of w |difference|."""
    colors, total = to_ycbcr(x), light.new_zeros(())
    height, width = x.shape[2:]
    for down in range(RADIUS + 1):
        for right in range(-RADIUS if down else 1, RADIUS + 1):
            if down >= height or abs(right) >= width:
                continue
            here = (..., slice(down, None), slice(max(0, right), width + min(0, right)))
            there = (..., slice(None, height - down), slice(max(0, -right), width + min(0, -right)))
            weight = torch.exp(-(colors[here] - colors[there]).square().sum(1) / SPREAD)
            # A neighbour on the other side has the same differences: counted twice.
            total = total + 2 * (weight * (light[here] - light[there]).abs().sum(1)).mean()
    return total


def loss(network: nn.Module, dark: Tensor, config: SciConfig) -> Tensor:
    """Fidelity and smoothness of the illumination in every stage, and the condition of SCI++ where it is asked for."""
    assert isinstance(network, Sci)
    total = dark.new_zeros(())
    first = network.enhance.added(dark) if config.additivity else None
    for i, (s, x, light) in enumerate(network.stages(dark)):
        total = total + FIDELITY * (light - x).square().mean() + smoothness(x, light)
        if first is not None and i:
            apart = network.enhance.added(x) - first - network.enhance.added(s)
            total = total + config.additivity * apart.square().mean()
    return total


def _optimizer(network: nn.Module, config: SciConfig) -> Adam:
    return Adam(network.parameters(), lr=config.rate, betas=(0.9, 0.999), weight_decay=config.decay)


SCI = Kind(
    name="SCI",
    make=lambda config: Sci(),
    run=lambda network, picture, config: network(picture),
    rehearsal=Rehearsal(
        loss=loss, steps=lambda config: config.steps, optimizer=_optimizer, clip=5.0,
        batch=lambda config: (config.batch, config.crop),
    ),
    where="one of the authors' easy.pt, medium.pt and difficult.pt",
)  # fmt: skip
enhance = SCI.enhance
