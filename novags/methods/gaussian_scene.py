"""A scene of Gaussians, as a method gives it back."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from novags.methods.tone import ResponseTable, ToneCurve
from novags.splats.files.ply import write_ply
from novags.splats.gaussians import Gaussians
from novags.splats.raster.rasterize import rasterize
from novags.splats.training.config import NEAR, FitConfig
from novags.splats.views import Views


@dataclass(frozen=True)
class GaussianScene:
    """A scene of Gaussians, shown as `eps2d`, `antialiased` and `near_plane` of its FitConfig say.

    Attributes:
        gaussians: The Gaussians.
        eps2d: As in `FitConfig`.
        antialiased: As in `FitConfig`.
        near_plane: As in `FitConfig`.
        tone: Their colours are tones of this curve, and renders are light; None: renders are their colours.
        matrix: [3, 3] from that light, or from their colours, to the rendered light; None: the identity. The
            development of pictures clips light at 1 before it; renders do not.
        response: Their colours are radiance, and renders show it through this camera response; None: unchanged.
    """

    gaussians: Gaussians
    eps2d: float = FitConfig.eps2d
    antialiased: bool = FitConfig.antialiased
    near_plane: float = NEAR
    tone: ToneCurve | None = None
    matrix: Tensor | None = None
    response: ResponseTable | None = None

    @staticmethod
    def of(gaussians: Gaussians, config: FitConfig) -> "GaussianScene":
        """The scene that a fit with this configuration has trained."""
        return GaussianScene(gaussians, config.eps2d, config.antialiased, config.near_plane)

    def along(self, kept: Mapping[int, Gaussians]) -> "dict[int, GaussianScene]":
        """The scene with each of the Gaussians that a fit kept, shown as this one is."""
        device = self.gaussians.means.device
        return {at: dataclasses.replace(self, gaussians=one.to(device)) for at, one in sorted(kept.items())}

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """As `ReconstructedScene` says."""
        images, alphas = self.splatted(
            self.gaussians.sh, views, sh_degree=self.gaussians.sh_degree, render_mode="RGB+ED"
        )
        return self.shown(images[..., :3]), alphas[..., 0], images[..., 3]

    def shown(self, colors: Tensor) -> Tensor:
        """Rendered colours [..., 3] as the scene shows them."""
        if self.tone is not None:
            colors = self.tone.light(colors)
        if self.matrix is not None:
            colors = colors @ self.matrix.to(colors).T
        if self.response is not None:
            colors = self.response.codes(colors)
        return colors

    def splatted(self, values: Tensor, views: Views, **more: Any) -> tuple[Tensor, Tensor]:
        """Rendered values of the Gaussians [N, D], or their harmonics [N, K, 3], and alphas; more: of `rasterize`."""
        g = self.gaussians
        with torch.no_grad():
            images, alphas, _ = rasterize(
                g.means, g.quats, g.scales, g.opacities, values, views.viewmats, views.Ks, views.width, views.height,
                eps2d=self.eps2d, rasterize_mode="antialiased" if self.antialiased else "classic",
                near_plane=self.near_plane, **more,
            )  # fmt: skip
        return images, alphas

    def save(self, folder: Path) -> None:
        """Write point_cloud.ply in the layout of 3DGS; other viewers show colours that are tones as a picture."""
        write_ply(folder / "point_cloud.ply", self.gaussians)

    def facts(self) -> dict[str, Any]:
        """Their number, and how they are to be splatted: the .ply does not say."""
        shown = {"eps2d": self.eps2d, "antialiased": self.antialiased, "near_plane": self.near_plane}
        facts: dict[str, Any] = {"gaussians": len(self.gaussians), **shown}
        if self.tone is not None:
            facts["tone"] = {"top": self.tone.top, "k": self.tone.k}
        if self.matrix is not None:
            facts["matrix"] = self.matrix.tolist()
        if self.response is not None:
            facts["response"] = dataclasses.asdict(self.response)
        return facts
