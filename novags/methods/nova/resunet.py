"""Deep Attention-ResUNet, the denoiser's network (paper, section 4.3.2; supplement, section B.3).

Images are [B, D, H, W] of any size; the network works on sizes padded to a multiple of 2**levels.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.nova.denoiser_config import ResUNetConfig


class InstanceNorm(nn.InstanceNorm2d):
    """Instance normalisation without parameters; a map that is constant up to rounding becomes 0, with no slope.

    Divided by its own deviation, as any other, it would be its rounding errors times 316 (1 / sqrt(eps)). Some layers
    of that turn a black view into noise of order one, and its gradients into infinities.
    """

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, D, H, W], normalised per image and channel."""
        low, high = x.detach().amin((2, 3), keepdim=True), x.detach().amax((2, 3), keepdim=True)
        # 1e-6: some float32 roundings of a sum of order one, such as a convolution's
        constant = high - low <= 1e-6 * (1 + torch.maximum(high, -low))
        return torch.where(constant, 0.0, super().forward(x))


def _norm(channels: int, kind: str) -> nn.Module:
    return InstanceNorm(channels) if kind == "instance" else nn.Identity()


def _conv(channels_in: int, channels_out: int, kind: str) -> list[nn.Module]:
    """Reflection padding, 3 x 3 convolution, normalisation."""
    return [nn.Conv2d(channels_in, channels_out, 3, padding=1, padding_mode="reflect"), _norm(channels_out, kind)]


class SqueezeExcite(nn.Module):
    """Channel gate from global means: adaptive average pool, reduction, ReLU, sigmoid (Hu et al. 2018)."""

    def __init__(self, channels: int, reduction: int) -> None:
        super().__init__()
        hidden = max(1, channels // reduction)
        self.gate = nn.Sequential(
            nn.AdaptiveAvgPool2d(1),
            nn.Conv2d(channels, hidden, 1),
            nn.ReLU(),
            nn.Conv2d(hidden, channels, 1),
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
        self.enter = nn.Sequential(*_conv(channels_in, channels, kind), nn.LeakyReLU(0.2))
        self.plain = config.blocks == "plain"
        if self.plain:
            self.second = nn.Sequential(*_conv(channels, channels, kind), nn.LeakyReLU(0.2))
            return
        self.residual = nn.Sequential(
            *_conv(channels, channels, kind), nn.LeakyReLU(0.2), *_conv(channels, channels, kind),
            SqueezeExcite(channels, config.se_reduction),
        )  # fmt: skip

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, channels_in, H, W] to [B, channels, H, W]."""
        x = self.enter(x)
        if self.plain:
            return self.second(x)
        return F.leaky_relu(x + self.residual(x), 0.2)


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
        self.reduce = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in zip(self.config.widths, below, strict=True))
        self.decoder = nn.ModuleList(GatedLevel(2 * a, a, self.config) for a in self.config.widths)
        self.head = nn.Conv2d(self.config.widths[0], channels, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Denoise images.

        Args:
            images: [B, D, H, W] float32, at least 1 px on each side.

        Returns:
            [B, D, H, W] float32, not clipped.
        """
        height, width = images.shape[-2:]
        multiple = 2 ** len(self.encoder)
        # Two px at the bottleneck: reflection by one pixel does not exist in an image of one.
        down = max(2 * multiple, -(-height // multiple) * multiple) - height
        right = max(2 * multiple, -(-width // multiple) * multiple) - width
        mode = "reflect" if down < height and right < width else "replicate"
        x = F.pad(images, (0, right, 0, down), mode=mode) if down or right else images
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.config.precision == "bfloat16"):
            x = self._run(x)
        return x[..., :height, :width].float()

    def _run(self, x: Tensor) -> Tensor:
        skips = []
        for level in self.encoder:
            x = level(x)
            skips.append(x)
            x = F.max_pool2d(x, 2)
        x = self.bottleneck(x)
        for i in reversed(range(len(skips))):
            x = self.reduce[i](F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False))
            x = self.decoder[i](torch.cat([x, skips[i]], 1))
        return self.head(x)
