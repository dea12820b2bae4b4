"""One iteration of a fit as its losses see it, and the kinds of losses that the CPU has a direct way for."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from torch import Tensor

from ..gaussians import Gaussians
from ..raster.rasterize import rasterize
from ..views import Views

Info = Mapping[str, Any]


@runtime_checkable
class PixelLoss(Protocol):
    """A photometric loss of the picture alone that brings its own gradient."""

    def __call__(self, step: "Step", target: Tensor) -> Tensor:
        """The loss, a scalar, by autograd."""
        ...

    def compare(self, image: np.ndarray, target: np.ndarray) -> tuple[np.float32, np.ndarray]:
        """The loss of float32 arrays [H, W, 3], and its gradient for the image."""
        ...


@runtime_checkable
class PictureLoss(Protocol):
    """A loss of the pictures of a Step: its `render`, `alpha`, `depth` and `views`; all else is constant to it.

    Other views, and the places of the Gaussians, it may read. The CPU then needs autograd for its own computation
    alone, and none for the Gaussians.
    """

    def trained_along(self) -> Iterable[Tensor]:
        """Parameters that its gradient is wanted for too: of networks that are part of it."""
        ...

    def __call__(self, step: "Step", *target: Tensor) -> Tensor | None:
        """The loss, a scalar; None where it is not due."""
        ...


@dataclass(frozen=True)
class HarmonicsPenalty:
    """A loss: the sum of w_i |c_ik|^2 over the harmonics k > 0 of all Gaussians i; the CPU has a kernel for it.

    Attributes:
        weights: Gives w [N] >= 0 for a Step, without gradient; None where the loss is not due.
    """

    weights: "Callable[[Step], Tensor | None]"

    def __call__(self, step: "Step") -> Tensor | None:
        """The loss by autograd, on any device."""
        weights = self.weights(step)
        return None if weights is None else harmonics_penalty(step.gaussians.sh, weights)


def harmonics_penalty(sh: Tensor, weights: Tensor) -> Tensor:
    """The sum of w_i |c_ik|^2 over the harmonics k > 0 of all Gaussians i: a scalar of sh [N, K, 3], weights [N]."""
    return (weights * sh[:, 1:].square().sum((1, 2))).sum()


@dataclass(kw_only=True)
class Step:
    """One iteration; `render`, `alpha` and `depth` are differentiable.

    Attributes:
        iteration: From 0.
        iterations: Of the whole run.
        view: Index of this iteration's training view.
        gaussians: The trained leaves.
        render: [H, W, 3].
        alpha: [H, W].
        info: Of `rasterize`, not packed, for this one view: "means2d" [1, N, 2], "radii" [1, N, 2], "depths" [1, N].
        views: All training views in their present state; where cameras are refined, `views.viewmats` is differentiable
            too.
        splat: Renders other values of the same Gaussians from this view: [N, D] -> [H, W, D], or spherical harmonics
            [N, K, 3] -> [H, W, 3] of the degree that `render` shows; differentiable in the values and the Gaussians.
        rasterize_view: Renders view j now: (render [H, W, 3], depth [H, W], alpha [H, W], info).
        expected_depth: [H, W], or None where `needs_depth` did not ask for it.
    """

    iteration: int
    iterations: int
    view: int
    gaussians: Gaussians
    render: Tensor
    alpha: Tensor
    info: Info
    views: Views
    splat: Callable[[Tensor], Tensor]
    rasterize_view: Callable[[int], tuple[Tensor, Tensor, Tensor, Info]]
    expected_depth: Tensor | None

    @property
    def visible(self) -> Tensor:
        """Which Gaussians this view shows, [N] bool."""
        cheap = self.info.get("visible")
        return (self.info["radii"][0] > 0).all(-1) if cheap is None else cheap[0]

    @property
    def depth(self) -> Tensor:
        """Expected depth [H, W], world units, 0 where nothing was hit.

        Raises:
            ValueError: If the fit was not asked for depth in this iteration.
        """
        if self.expected_depth is None:
            raise ValueError(
                f"depth was not rendered in iteration {self.iteration}: call fit(..., needs_depth=True), or pass a "
                "function of the iteration that is true there"
            )
        return self.expected_depth


def render_step(
    gaussians: Gaussians,
    scales: Tensor,
    opacities: Tensor,
    views: Views,
    *,
    view: int,
    iteration: int,
    iterations: int,
    sh_degree: int,
    with_depth: bool,
    splatting: Mapping[str, Any],
    backend: str,
    known: bool = False,
) -> Step:
    """Render a training view, with expected depth if asked for.

    Args:
        gaussians: The trained leaves.
        scales: Of the Gaussians, activated [N, 3].
        opacities: Of the Gaussians, activated [N].
        views: All training views.
        view: Index of the view to render.
        iteration: From 0.
        iterations: Of the whole run.
        sh_degree: Highest spherical-harmonics degree to render, 0..3.
        with_depth: Render expected depth too.
        splatting: Further arguments of `rasterize`, as `FitConfig.splatting` says.
        backend: As in `rasterize`.
        known: Numbers are not checked here, for somebody else does.
    """

    def render(j: int, mode: str, colors: Tensor = gaussians.sh) -> tuple[Tensor, Tensor, Info]:
        degree = sh_degree if colors.ndim == 3 else None
        renders, alphas, info = rasterize(
            gaussians.means, gaussians.quats, scales, opacities, colors, views.viewmats[j : j + 1],
            views.Ks[j : j + 1], views.width, views.height, sh_degree=degree, render_mode=mode, backend=backend,
            packed=False, check_values=not known, **splatting,
        )  # fmt: skip
        return renders[0], alphas[0, ..., 0], info

    def splat(values: Tensor) -> Tensor:
        return render(view, "RGB", values)[0]

    def rasterize_view(j: int) -> tuple[Tensor, Tensor, Tensor, Info]:
        image, alpha, info = render(j, "RGB+ED")
        return image[..., :3], image[..., 3], alpha, info

    image, alpha, info = render(view, "RGB+ED" if with_depth else "RGB")
    return Step(
        iteration=iteration, iterations=iterations, view=view, gaussians=gaussians, render=image[..., :3],
        alpha=alpha, info=info, views=views, splat=splat, rasterize_view=rasterize_view,
        expected_depth=image[..., 3] if with_depth else None,
    )  # fmt: skip
