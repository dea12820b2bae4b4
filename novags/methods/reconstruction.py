"""What a method gives back: a scene that can be rendered and saved, and how it came about."""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

import torch
from torch import Tensor

from novags.methods.enhancers.enhancer import NETWORK
from novags.methods.tone import ResponseTable, ToneCurve
from novags.splats.files.ply import write_ply
from novags.splats.gaussians import Gaussians
from novags.splats.raster.rasterize import rasterize
from novags.splats.training.checkpoint import write_tensors
from novags.splats.training.config import NEAR, FitConfig
from novags.splats.views import Views

Space = Literal["enhanced", "linear", "lit"]


class Scene(Protocol):
    """A reconstructed scene of any kind."""

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """Image [C, H, W, 3], alpha [C, H, W] in 0..1, z-depth [C, H, W] (0 where there is nothing).

        The depth is the weighted mean along the ray (Gaussians), or the depth that halves its weight (fields).
        """
        ...

    def save(self, folder: Path) -> None:
        """Write the scene into an existing folder, in formats that others read."""
        ...

    def facts(self) -> dict[str, Any]:
        """For the record: numbers of primitives, parameters and bytes."""
        ...


@dataclass(frozen=True)
class GaussianScene:
    """A scene of Gaussians, shown as `eps2d`, `antialiased` and `near_plane` of its FitConfig say.

    Attributes:
        gaussians: The Gaussians.
        eps2d: As in `FitConfig`.
        antialiased: As in `FitConfig`.
        near_plane: As in `FitConfig`.
        tone: Their colours are tones of this curve, and renders are light; None: renders are what they hold.
        matrix: [3, 3] from that light, or from what they hold, to the light that is rendered; None: the identity. The
            development of pictures clips light at 1 before it; renders do not.
        response: Their colours are radiance, and renders show it through this camera response; None: as it is.
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
        """What a fit with this configuration has trained."""
        return GaussianScene(gaussians, config.eps2d, config.antialiased, config.near_plane)

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """As `Scene` says."""
        images, alphas = self.splatted(
            self.gaussians.sh, views, sh_degree=self.gaussians.sh_degree, render_mode="RGB+ED"
        )
        colors = images[..., :3]
        if self.tone is not None:
            colors = self.tone.light(colors)
        if self.matrix is not None:
            colors = colors @ self.matrix.to(colors).T
        if self.response is not None:
            colors = self.response.codes(colors)
        return colors, alphas[..., 0], images[..., 3]

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


@dataclass(kw_only=True)
class Reconstruction:
    """The outcome of one method.

    Attributes:
        scene: What can be rendered and saved.
        space: What its colours are: "enhanced" (the dark pictures brightened), "linear" (the scene's light, any
            exposure), "lit" (as in good light, sRGB).
        config: The resolved configuration; `dataclasses.asdict` of it is saved.
        enhancement: What made the dark pictures bright, for methods in the space "enhanced": {"enhancer", "pictures",
            "config"}. The noise-free exposure goes through the same before renders are compared with it. A method in
            the space "linear" may state one too: its renders then go through it, with the parameters that the training
            views have on average, and are compared like those of methods that enhance.
        enhanced: The enhanced training pictures [C, H, W, 3], or None.
        targets: What the scene was finally fitted to [C, H, W, 3] (denoised pictures, say), or None.
        viewmats: The training cameras at the end of training [C, 4, 4]; None: unchanged.
        losses: Log entries of the training.
        seconds: Wall time by part.
        found: What it measured and decided on the way, for the record; plain values.
        network: Weights of the network that enhanced the pictures, by name, for methods with one. `save` writes them
            too, to `NETWORK`, which the configuration of the enhancement names.
    """

    scene: Scene
    space: Space
    config: Any
    enhancement: dict[str, Any] | None = None
    enhanced: Tensor | None = None
    targets: Tensor | None = None
    viewmats: Tensor | None = None
    losses: list[dict[str, float]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    found: dict[str, Any] = field(default_factory=dict)
    network: dict[str, Tensor] | None = None

    def __post_init__(self) -> None:
        if (self.space == "enhanced" and self.enhancement is None) or (self.space == "lit" and self.enhancement):
            raise ValueError(
                "a reconstruction in the space 'enhanced' states its enhancement, and one in the space 'lit' does not, "
                f"got {self.space!r} with {self.enhancement}"
            )

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """See `Scene.render`."""
        return self.scene.render(views)

    def save(self, folder: Path) -> None:
        """See `Scene.save`."""
        self.scene.save(folder)
        if self.network is not None:
            write_tensors(folder / NETWORK, self.network)
