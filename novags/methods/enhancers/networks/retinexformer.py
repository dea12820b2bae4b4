"""Retinexformer (Cai et al. 2023, "Retinexformer: One-stage Retinex-based Transformer for Low-light Image
Enhancement").

An estimator gives a light-up map and features of the light; the picture times the map, plus itself, goes through a
U-Net of two levels whose blocks attend over channels: each head compares its channels over all pixels, and its values
are multiplied with the features of the light (illumination-guided attention). Sizes as published: 40 features, 1, 2 and
2 blocks, 1.6 million parameters; one stage. The layers have the names of the authors' code (MIT), so that official
files fit.

Deviations: pictures are extended to a multiple of 4 px by repeating their border, not by reflection, which needs larger
ones. It does not learn from a scene: it needs pairs.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.enhancers.networks.kind import Kind

WIDTH, BLOCKS = 40, (1, 2, 2)
MULTIPLE = 4  # px: two levels, each half the size


class Estimator(nn.Module):
    """A picture [B, 3, H, W] -> features of the light [B, width, H, W] and the light-up map [B, 3, H, W]."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(4, width, 1)
        self.depth_conv = nn.Conv2d(width, width, 5, padding=2, groups=4)
        self.conv2 = nn.Conv2d(width, 3, 1)

    def forward(self, picture: Tensor) -> tuple[Tensor, Tensor]:
        """Features and map, from the picture and the mean of its channels."""
        light = self.depth_conv(self.conv1(torch.cat([picture, picture.mean(1, keepdim=True)], 1)))
        return light, self.conv2(light)


class Attention(nn.Module):
    """Illumination-guided attention over channels, with a convolution that knows positions beside it."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_q, self.to_k, self.to_v = (nn.Linear(width, width, bias=False) for _ in range(3))
        self.rescale = nn.Parameter(torch.ones(heads, 1, 1))
        self.proj = nn.Linear(width, width)
        depthwise = [nn.Conv2d(width, width, 3, padding=1, bias=False, groups=width) for _ in range(2)]
        self.pos_emb = nn.Sequential(depthwise[0], nn.GELU(), depthwise[1])

    def forward(self, x: Tensor, light: Tensor) -> Tensor:
        """Both [B, H, W, width] -> the same shape."""
        batch, height, width, channels = x.shape

        def by_head(values: Tensor) -> Tensor:  # [B, heads, channels of a head, pixels]
            return values.reshape(batch, height * width, self.heads, -1).permute(0, 2, 3, 1)

        value = self.to_v(x)
        query, key = (F.normalize(by_head(layer(x)), dim=-1) for layer in (self.to_q, self.to_k))
        weights = (key @ query.transpose(-2, -1) * self.rescale).softmax(-1)
        mixed = (weights @ by_head(value * light)).permute(0, 3, 1, 2).reshape(batch, height, width, channels)
        placed = self.pos_emb(value.movedim(-1, 1)).movedim(1, -1)
        out: Tensor = self.proj(mixed) + placed
        return out


class FeedForward(nn.Module):
    """Three convolutions, the middle one of each channel by itself."""

    def __init__(self, width: int) -> None:
        super().__init__()
        wide = 4 * width
        self.net = nn.Sequential(
            nn.Conv2d(width, wide, 1, bias=False), nn.GELU(),
            nn.Conv2d(wide, wide, 3, padding=1, bias=False, groups=wide), nn.GELU(),
            nn.Conv2d(wide, width, 1, bias=False),
        )  # fmt: skip

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, H, W, width]."""
        out: Tensor = self.net(x.movedim(-1, 1)).movedim(1, -1)
        return out


class Normed(nn.Module):
    """A layer norm before the feed-forward network."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.fn, self.norm = FeedForward(width), nn.LayerNorm(width)

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, H, W, width]."""
        out: Tensor = self.fn(self.norm(x))
        return out


def _parts(layer: nn.Module) -> list[nn.Module]:
    return list(layer.children())


class Blocks(nn.Module):
    """Attention and feed-forward networks in turn, each beside the identity."""

    def __init__(self, width: int, heads: int, count: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(nn.ModuleList([Attention(width, heads), Normed(width)]) for _ in range(count))

    def forward(self, x: Tensor, light: Tensor) -> Tensor:
        """Both [B, width, H, W]."""
        x, light = x.movedim(1, -1), light.movedim(1, -1)
        for block in self.blocks:
            attend, feed = _parts(block)
            x = attend(x, light) + x
            x = feed(x) + x
        return x.movedim(-1, 1)


class Restorer(nn.Module):
    """The U-Net; a picture and features of the light -> the restored picture."""

    def __init__(self, width: int, blocks: tuple[int, int, int]) -> None:
        super().__init__()
        self.embedding = nn.Conv2d(3, width, 3, padding=1, bias=False)
        self.encoder_layers, self.decoder_layers = nn.ModuleList(), nn.ModuleList()
        for level in range(2):
            wide, heads = width << level, 1 << level
            halving = [nn.Conv2d(wide, 2 * wide, 4, 2, 1, bias=False) for _ in range(2)]
            self.encoder_layers.append(nn.ModuleList([Blocks(wide, heads, blocks[level]), *halving]))
        self.bottleneck = Blocks(4 * width, 4, blocks[2])
        for level in (1, 0):
            wide, heads = width << level, 1 << level
            self.decoder_layers.append(nn.ModuleList([
                nn.ConvTranspose2d(2 * wide, wide, 2, 2), nn.Conv2d(2 * wide, wide, 1, bias=False),
                Blocks(wide, heads, blocks[level]),
            ]))  # fmt: skip
        self.mapping = nn.Conv2d(width, 3, 3, padding=1, bias=False)

    def forward(self, x: Tensor, light: Tensor) -> Tensor:
        """x: [B, 3, H, W], light: [B, width, H, W]; sizes are multiples of 4."""
        seen, levels = self.embedding(x), []
        for layer in self.encoder_layers:
            attend, halve, halve_light = _parts(layer)
            seen = attend(seen, light)
            levels.append((seen, light))
            seen, light = halve(seen), halve_light(light)
        seen = self.bottleneck(seen, light)
        for layer in self.decoder_layers:
            double, fuse, attend = _parts(layer)
            finer, light = levels.pop()
            seen = attend(fuse(torch.cat([double(seen), finer], 1)), light)
        out: Tensor = self.mapping(seen) + x
        return out


class RetinexStage(nn.Module):
    """Estimator and U-Net."""

    def __init__(self, width: int, blocks: tuple[int, int, int]) -> None:
        super().__init__()
        self.estimator, self.denoiser = Estimator(width), Restorer(width, blocks)

    def forward(self, picture: Tensor) -> Tensor:
        """picture: [B, 3, H, W] in 0..1."""
        light, up = self.estimator(picture)
        out: Tensor = self.denoiser(picture * up + picture, light)
        return out


class Retinexformer(nn.Module):
    """One stage."""

    def __init__(self, width: int = WIDTH, blocks: tuple[int, int, int] = BLOCKS) -> None:
        super().__init__()
        self.body = nn.Sequential(RetinexStage(width, blocks))
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.trunc_normal_(module.weight, std=0.02)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)

    def forward(self, picture: Tensor) -> Tensor:
        """picture: [B, 3, H, W] in 0..1, of any size."""
        height, width = picture.shape[2:]
        whole = F.pad(picture, (0, -width % MULTIPLE, 0, -height % MULTIPLE), mode="replicate")
        out: Tensor = self.body(whole)
        return out[..., :height, :width]


RETINEXFORMER = Kind(
    name="Retinexformer", make=lambda config: Retinexformer(),
    run=lambda network, picture, config: network(picture),
)  # fmt: skip
enhance = RETINEXFORMER.enhance
