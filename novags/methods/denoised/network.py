"""The network: a residual U-Net on packed pixels in units of the noise.

It is given data whose noise has variance 1 (see `anscombe`), which pixels of which channels were measured, and how much
of the noise is read noise; it returns its estimate of the noise-free value of every channel of every pixel. Channels
that were not measured start from their bilinear interpolation, so it also demosaics a mosaic.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.denoised.packing import filled, pack, unpack

CHANNELS = 12  # of a packed cell: three colours of 2 x 2 pixels
SCALE = 8.0  # of local means in units of the noise: brings twenty electrons to about one
LARGEST_READ_VARIANCE = 18.0  # electrons**2, of the cameras in training
WINDOW = 5  # px, of local means: the network is given the difference from them, in which noise is of order one


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """Size of the network."""

    widths: tuple[int, ...] = (24, 48, 96, 128)  # channels of each level, finest first
    blocks: tuple[int, ...] = (1, 1, 1, 1)  # residual blocks of each level; each of the finer ones has them twice

    def __post_init__(self) -> None:
        if len(self.widths) < 2 or len(self.widths) != len(self.blocks):
            raise ValueError(
                f"widths and blocks must name the same two or more levels, got {self.widths} and {self.blocks}"
            )
        if min(*self.widths, *self.blocks) < 1:
            raise ValueError(f"widths and blocks must be >= 1, got {self.widths} and {self.blocks}")


class ResidualPair(nn.Module):
    """Two 3 x 3 convolutions beside the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)
        nn.init.zeros_(self.second.weight)  # a deep network without normalisation starts as a shallow one
        nn.init.zeros_(self.second.bias)  # type: ignore[arg-type]

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, width, H, W]."""
        return x + self.second(F.relu(self.first(x)))


class Network(nn.Module):
    """Encoder and decoder with added skip connections."""

    def __init__(self, config: NetworkConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or NetworkConfig()
        widths, blocks = config.widths, config.blocks
        self.enter = nn.Conv2d(2 * CHANNELS + 4, widths[0], 3, padding=1)
        pairs = list(zip(widths[:-1], widths[1:], strict=True))
        self.down = nn.ModuleList(nn.Conv2d(a, b, 2, stride=2) for a, b in pairs)
        self.up = nn.ModuleList(nn.ConvTranspose2d(b, a, 2, stride=2) for a, b in pairs)
        self.encoder = nn.ModuleList(_blocks(w, n) for w, n in zip(widths[:-1], blocks[:-1], strict=True))
        self.decoder = nn.ModuleList(_blocks(w, n) for w, n in zip(widths[:-1], blocks[:-1], strict=True))
        self.middle = _blocks(widths[-1], blocks[-1])
        self.leave = nn.Conv2d(widths[0], CHANNELS, 3, padding=1)
        nn.init.zeros_(self.leave.weight)  # before training it returns its input
        nn.init.zeros_(self.leave.bias)  # type: ignore[arg-type]

    def forward(self, values: Tensor, mask: Tensor, read_variance: Tensor) -> Tensor:
        """Estimate the noise-free picture.

        Args:
            values: [B, 3, H, W] float32 in units of the noise, 0 = black; anything where the mask is 0.
            mask: [B, 3, H, W], 1 where a channel was measured.
            read_variance: [B, 3], electrons**2.

        Returns:
            [B, 3, H, W], all channels, in units of the noise.
        """
        height, width = values.shape[-2:]
        base = filled(values, mask)
        multiple = 2 ** len(self.config.widths)
        margin = [(-side) % multiple for side in (height, width)]
        whole, marks = (_padded(x, margin[0], margin[1]) for x in (base, mask))
        noise = self.noise(whole, marks, read_variance)
        return base - noise[..., :height, :width]

    def noise(self, base: Tensor, mask: Tensor, read_variance: Tensor) -> Tensor:
        """The noise to subtract from pictures without gaps, whose sides every level divides, [B, 3, H, W]."""
        smooth = F.avg_pool2d(base, WINDOW, 1, WINDOW // 2, count_include_pad=False)
        x = pack(base - smooth)
        # 1/8: cameras without read noise have a level, too. Beyond the levels of its training, noise is as good as all
        # read noise, and a network does not know the meaning of larger numbers.
        level = torch.log2(read_variance.mean(1).clamp_max(LARGEST_READ_VARIANCE) + 1 / 8) / 4
        constant = level[:, None, None, None].expand(-1, 1, *x.shape[-2:])
        inputs = torch.cat([x, F.avg_pool2d(smooth, 2) / SCALE, pack(mask), constant], 1)
        return unpack(self._run(inputs.contiguous(memory_format=torch.channels_last)))

    def _run(self, x: Tensor) -> Tensor:
        x, skips = self.enter(x), []
        for encode, down in zip(self.encoder, self.down, strict=True):
            x = encode(x)
            skips.append(x)
            x = down(x)
        x = self.middle(x)
        for i in reversed(range(len(skips))):
            x = self.decoder[i](self.up[i](x) + skips[i])
        return self.leave(x)


def _blocks(width: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(ResidualPair(width) for _ in range(count)))


def _padded(x: Tensor, down: int, right: int) -> Tensor:
    """Mirrored about the last row and column, again and again where a picture is smaller than the margin.

    That keeps every pixel of a mosaic under its own filter; a single row or column can only be repeated.
    """
    while down or right:
        step = min(down, x.shape[-2] - 1), min(right, x.shape[-1] - 1)
        mode = "reflect" if any(step) else "replicate"
        step = step if any(step) else (down, right)
        x = F.pad(x, (0, step[1], 0, step[0]), mode=mode)
        down, right = down - step[0], right - step[1]
    return x
