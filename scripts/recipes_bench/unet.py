"""The small network of all three recipes, and how it is trained."""

import math
import time
from collections.abc import Callable
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.splats.files.tensors import read, write_tensors

WIDTHS = (24, 48, 96)  # channels of the levels: 270,000 weights
RATE = 1e-3  # Adam's, rising for `WARM_UP` steps, then falling to 0 along a cosine
WARM_UP = 100
LARGEST_GRADIENT = 1.0  # or a single batch spoils a network for good
SAID = 200  # steps between two lines


class UNet(nn.Module):
    """Two 3 x 3 convolutions a level, skips, bilinear enlargement."""

    def __init__(self, channels: int, found: int, widths: tuple[int, ...] = WIDTHS) -> None:
        """channels, found: of the input and the output."""
        super().__init__()
        inputs = (channels, *widths)
        self.down = nn.ModuleList(_level(a, b) for a, b in zip(inputs[:-1], widths, strict=True))
        self.up = nn.ModuleList(_level(a + b, a) for a, b in zip(widths[:-1], widths[1:], strict=True))
        self.head = nn.Conv2d(widths[0], found, 1)
        nn.init.zeros_(self.head.weight)
        assert self.head.bias is not None
        nn.init.zeros_(self.head.bias)

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, channels, h, w], sides divisible by 4. Returns [B, found, h, w]."""
        x, skips = x.contiguous(memory_format=torch.channels_last), list[Tensor]()  # which convolutions are faster in
        for level in self.down:
            x = level(F.avg_pool2d(x, 2) if skips else x)
            skips.append(x)
        for level, skip in zip(self.up[::-1], skips[-2::-1], strict=True):
            wide = F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
            x = level(torch.cat([skip, wide], 1))
        found: Tensor = self.head(x)
        return found


def _level(channels: int, width: int) -> nn.Module:
    return nn.Sequential(
        nn.Conv2d(channels, width, 3, padding=1, padding_mode="replicate"), nn.LeakyReLU(0.1),
        nn.Conv2d(width, width, 3, padding=1, padding_mode="replicate"), nn.LeakyReLU(0.1),
    )  # fmt: skip


def trained(
    network: nn.Module, loss: Callable[[nn.Module, torch.Generator], Tensor], steps: int, seed: int, kept: Path
) -> nn.Module:
    """The network after so many steps on `loss`, which draws its batch by the generator; kept in a file when done."""
    if kept.exists():
        network.load_state_dict(read(kept))
        return network.eval()
    optimiser, draw = torch.optim.Adam(network.parameters(), RATE), torch.Generator().manual_seed(seed)
    started, mean = time.perf_counter(), 0.0
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = 0.5 * RATE * (1 + math.cos(math.pi * step / steps)) * min(1.0, (step + 1) / WARM_UP)
        optimiser.zero_grad()
        value = loss(network, draw)
        value.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), LARGEST_GRADIENT)
        optimiser.step()
        mean += value.item() / SAID
        if (step + 1) % SAID == 0:
            left = (time.perf_counter() - started) * (steps / (step + 1) - 1) / 60
            print(f"{kept.stem}: step {step + 1} of {steps}, loss {mean:.4f}, {left:.1f} min left", flush=True)
            mean = 0.0
    write_tensors(kept, dict(network.state_dict()))
    return network.eval()


def turned(picture: Tensor, draw: torch.Generator) -> Tensor:
    """One of the eight flips and quarter turns of [..., h, w], h = w."""
    k = int(torch.randint(8, (), generator=draw))
    picture = torch.rot90(picture, k % 4, (-2, -1))
    return picture.flip(-1) if k >= 4 else picture
