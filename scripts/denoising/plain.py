"""The paper's denoiser of torch's own modules and optimiser, layer by layer: what ours is held to."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import DenoiserConfig, ResUNetConfig
from novags.methods.nova.resunet import Convolution, GlobalMean, InstanceNorm, ResUNet


class PlainNorm(InstanceNorm):
    """By torch's operators."""

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, D, H, W]."""
        return self.plain(x)


class PlainResUNet(ResUNet):
    """The network; its weights have the names of ours."""

    def __init__(self, config: ResUNetConfig, channels: int = 3) -> None:
        super().__init__(config, channels)
        for module in list(self.modules()):
            for name, child in list(module.named_children()):
                setattr(module, name, _plain(child))

    def _run(self, x: Tensor, large: bool = False) -> Tensor:  # levels always keep their maps here
        with torch.autocast(x.device.type, torch.bfloat16, enabled=x.dtype == torch.bfloat16):
            x, skips = x.float(), []
            for level in self.encoder:
                x = level(x)
                skips.append(x)
                x = F.max_pool2d(x, 2)
            x = self.bottleneck(x)
            for reduce, decode, skip in zip(self.reduce[::-1], self.decoder[::-1], skips[::-1], strict=True):
                x = reduce(F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False))
                x = decode(torch.cat([x, skip], 1))
            return self.head(x)


def _plain(layer: nn.Module) -> nn.Module:
    if isinstance(layer, Convolution):
        edge = layer.edge
        return nn.Conv2d(layer.in_channels, layer.out_channels, edge, padding=edge // 2, padding_mode="reflect")
    if isinstance(layer, InstanceNorm):
        return PlainNorm(layer.num_features, layer.slope)
    if isinstance(layer, nn.LeakyReLU):
        return nn.LeakyReLU(layer.negative_slope)
    return nn.AdaptiveAvgPool2d(1) if isinstance(layer, GlobalMean) else layer


def torchs(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """Kernels [O, edge, edge, I] in torch's order, [O, I, edge, edge]; biases are as they are."""
    return {name: value.movedim(-1, 1) if value.ndim == 4 else value for name, value in tensors.items()}


def pair(views: Tensor, config: DenoiserConfig, *, total_steps: int = 100) -> list[Denoiser]:
    """Our denoiser and the plain one on the same views [C, H, W, 3], with the same weights and draws."""
    ours, plain = (Denoiser(views, config, total_steps=total_steps, seed=0) for _ in range(2))
    network = PlainResUNet(config.network)
    network.load_state_dict(torchs(ours.network.state_dict()))
    plain.network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    plain.optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    return [ours, plain]
