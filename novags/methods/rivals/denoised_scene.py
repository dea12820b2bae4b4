"""Gaussians whose renders lose their noise: each has a noise of its own, and networks refine the rendered noise.

    N_0 = rendered noise,    N_k+1 = N_k + F_k(N_k),    shown = clamp(rendered colours - N_3, 0, 1)

The progressive denoising of LITA-GS (Zhou et al. 2025). Each F_k is a network like the illumination estimator of SCI
(Ma et al. 2022) without its batch normalisation, which one view at a time has no use for, and without its sigmoid:
noise has both signs.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from novags.methods.gaussian_scene import GaussianScene
from novags.splats.files.tensors import write_tensors
from novags.splats.views import Views
from sensor_model.files.door import admitted
from sensor_model.files.reading import brief

STAGES = 3
FILE = Path("scene") / "denoiser.safetensors"  # in the folder of a run: networks, and the noise of its Gaussians
NOISE = "noise"


class DenoiserStage(nn.Module):
    """F: [1, 3, H, W] to the same shape; nothing at first."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.inner = nn.Conv2d(3, width, 3, padding=1)
        self.middle = nn.Conv2d(width, width, 3, padding=1)
        self.outer = nn.Conv2d(width, 3, 3, padding=1, bias=False)
        nn.init.zeros_(self.outer.weight)

    def forward(self, noise: Tensor) -> Tensor:
        """The summand for the noise."""
        seen = torch.relu(self.inner(noise))
        out: Tensor = self.outer(seen + torch.relu(self.middle(seen)))
        return out


class StagedDenoiser(nn.Module):
    """All stages."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.stages = nn.ModuleList(DenoiserStage(width) for _ in range(STAGES))

    def forward(self, noise: Tensor) -> Tensor:
        """Refined noise of the rendered noise [H, W, 3]."""
        planes = noise.permute(2, 0, 1)[None]
        for stage in self.stages:
            planes = planes + stage(planes)
        return planes[0].permute(1, 2, 0)


@dataclass(frozen=True)
class DenoisedScene:
    """Gaussians, the noise of each, and the networks that refine it.

    Attributes:
        base: The Gaussians with their colours.
        noise: Of each Gaussian, [N, 3].
        denoiser: The networks.
    """

    base: GaussianScene
    noise: Tensor
    denoiser: StagedDenoiser

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """As `ReconstructedScene` says."""
        colors, alpha, depth = self.base.render(views)
        noise, _ = self.base.splatted(self.noise, views)
        with torch.no_grad():
            shown = torch.stack([(c - self.denoiser(n)).clamp(0, 1) for c, n in zip(colors, noise, strict=True)])
        return shown, alpha, depth

    def save(self, folder: Path) -> None:
        """Write point_cloud.ply, whose colours still have their noise, and scene/denoiser.safetensors."""
        self.base.save(folder)
        (folder / FILE).parent.mkdir(exist_ok=True)
        write_tensors(folder / FILE, {NOISE: self.noise, **self.denoiser.state_dict()})

    def facts(self) -> dict[str, Any]:
        """Facts about the Gaussians, and the size of the networks."""
        return {**self.base.facts(), "denoiser": {"parameters": sum(p.numel() for p in self.denoiser.parameters())}}


def with_denoiser(base: GaussianScene, folder: Path) -> "GaussianScene | DenoisedScene":
    """The scene of a run's folder, whose Gaussians are `base`; they themselves if it has no denoiser.

    Raises:
        ValueError: If its file is damaged, or of other Gaussians.
    """
    path = folder / FILE
    if not path.is_file():
        return base
    try:
        tensors = load_file(admitted(path))
        noise = tensors.pop(NOISE)
        denoiser = StagedDenoiser(tensors["stages.0.inner.weight"].shape[0])
        denoiser.load_state_dict(tensors)
        if noise.shape != (len(base.gaussians), 3):
            raise ValueError(f"noise must be [{len(base.gaussians)}, 3], as point_cloud.ply has it, got {noise.shape}")
        if not all(bool(torch.isfinite(tensor).all()) for tensor in (noise, *tensors.values())):
            raise ValueError("its numbers must be finite")
    except (SafetensorError, KeyError, RuntimeError, IndexError, ValueError) as error:
        reason = brief(f"{type(error).__name__}: {error}")
        raise ValueError(f"{path} is not the denoiser of this scene ({reason}): reconstruct again") from error
    return DenoisedScene(base, noise.float(), denoiser)
