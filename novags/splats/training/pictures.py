"""The losses of a view that the kernels rendered, and their gradients for its pictures: no autograd for Gaussians."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..cpu import pipeline
from ..gaussians import Gaussians
from ..raster.info import Watch, describe
from ..raster.raster_numba import projected
from ..views import Views
from .config import FitConfig
from .guard import all_finite
from .losses import compare
from .step import HarmonicsPenalty, PictureLoss, PixelLoss, Step

Compare = Callable[[np.ndarray, np.ndarray], tuple[np.float32, np.ndarray]]


class OutOfRange(ArithmeticError):
    """A number is not finite, or very large."""


@dataclass(frozen=True, kw_only=True)
class LossTerms:
    """The loss of a fit, by how its gradient is made.

    Attributes:
        compare: Photometric loss of a picture and its target, and its gradient for the picture; None if it is the first
            of `networks`.
        networks: Losses of pictures, by autograd.
        penalties: Of harmonics.
    """

    compare: Compare | None
    networks: tuple[PictureLoss, ...]
    penalties: tuple[HarmonicsPenalty, ...]

    @staticmethod
    def of(photometric: object | None, extra_losses: Sequence[object], dssim_weight: float) -> "LossTerms | None":
        """The terms of the losses of `fit`; None if one of them may depend on the Gaussians in another way."""
        by_pixel: Compare | None = None
        if photometric is None:
            by_pixel = partial(compare, dssim_weight=dssim_weight)
        elif isinstance(photometric, PixelLoss):
            by_pixel = photometric.compare
        losses = extra_losses if by_pixel is not None else (photometric, *extra_losses)
        networks = tuple(loss for loss in losses if isinstance(loss, PictureLoss))
        penalties = tuple(loss for loss in losses if isinstance(loss, HarmonicsPenalty))
        known = len(networks) + len(penalties) == len(losses)
        return LossTerms(compare=by_pixel, networks=networks, penalties=penalties) if known else None


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """The Gaussians of one iteration, for any of its views.

    Attributes:
        gaussians: As they are trained.
        shape: The same, activated.
        cameras: Of all views, where they were given.
        views: Where the cameras are now.
        degree: Of the harmonics.
    """

    gaussians: Gaussians
    shape: pipeline.Shape
    cameras: Sequence[pipeline.RasterCamera]
    views: Views
    degree: int

    def __call__(self, view: int, with_depth: bool) -> tuple[pipeline.RasterFrame, np.ndarray, np.ndarray]:
        """Frame, image [H, W, 3], or 4 with accumulated depth, and alpha [H, W].

        Raises:
            OutOfRange: If the Gaussians are.
        """
        camera = replace(self.cameras[view], viewmat=self.views.viewmats[view].detach().contiguous().numpy())
        sh = self.gaussians.sh.detach().numpy()
        frame, image, alpha = pipeline.forward(self.shape, sh, camera, self.degree, True, with_depth)
        if frame.splats.suspect:
            raise OutOfRange
        return frame, image, alpha


def observe(
    rendering: Rendering, frame: pipeline.RasterFrame, image: Tensor, alpha: Tensor, views: Views, *, iteration: int,
    view: int, config: FitConfig,
) -> Step:  # fmt: skip
    """A Step for losses of pictures. The other views that it renders have no gradient."""

    def info_of(frame: pipeline.RasterFrame) -> Mapping[str, Any]:
        splats, rows = frame.splats, torch.from_numpy(frame.splats.rows)
        seen = projected(rows[:, :2], torch.from_numpy(splats.radii), torch.from_numpy(splats.depths), rows)
        return describe([seen], Watch(False), width=views.width, height=views.height, packed=False)

    def rasterize_view(j: int) -> tuple[Tensor, Tensor, Tensor, Mapping[str, Any]]:
        other, picture, covered = rendering(j, True)
        seen, alpha = torch.from_numpy(picture), torch.from_numpy(covered)
        return seen[..., :3], _expected(seen, alpha), alpha, info_of(other)

    return Step(
        iteration=iteration, iterations=config.iterations, view=view, gaussians=rendering.gaussians.detach(),
        render=image[..., :3], alpha=alpha, info=info_of(frame), views=views, splat=_refused,
        rasterize_view=rasterize_view, expected_depth=_expected(image, alpha) if image.shape[-1] > 3 else None,
    )  # fmt: skip


def _expected(image: Tensor, alpha: Tensor) -> Tensor:
    return image[..., 3] / alpha.clamp_min(1e-10)  # eps: 0/0 where nothing was hit, as in `rasterize`


def _refused(values: Tensor) -> Tensor:
    raise ValueError("a PictureLoss has no gradient for the Gaussians, and so cannot splat other values: pass the loss "
                     "without `trained_along`")  # fmt: skip


@dataclass(kw_only=True)
class Slopes:
    """A loss and its gradients.

    Attributes:
        loss: All of it but for the penalties.
        photometric: Its photometric part.
        v_image: [H, W, 3], or 4 with accumulated depth.
        v_alpha: [H, W].
        v_viewmats: [C, 4, 4], as far as the losses read them.
        beside: Parameters of networks, and their gradients.
        pull: Weights of the penalties [N]; empty without any.
    """

    loss: np.float32
    photometric: float
    v_image: np.ndarray
    v_alpha: np.ndarray
    v_viewmats: Tensor
    beside: list[tuple[Tensor, Tensor]]
    pull: np.ndarray


def slopes_of(
    terms: LossTerms, image: np.ndarray, alpha: np.ndarray, views: Views, target: Tensor,
    observed: Callable[[Tensor, Tensor, Views], Step],
) -> Slopes:  # fmt: skip
    """Evaluate the terms.

    Args:
        terms: The loss.
        image: [H, W, 3], or 4 with accumulated depth.
        alpha: [H, W].
        views: The cameras where they are.
        target: Of the photometric loss.
        observed: Makes the Step of an image, an alpha and views that gradients are wanted for.

    Raises:
        OutOfRange: If a number is not finite.
    """
    value, v_rgb = np.float32(0), None
    if terms.compare is not None:
        rgb = image if image.shape[-1] == 3 else np.ascontiguousarray(image[..., :3])
        value, v_rgb = terms.compare(rgb, target.detach().contiguous().numpy())
    if image.shape[-1] == 3 and v_rgb is not None:
        v_image = v_rgb
    else:
        v_image = np.zeros_like(image)
        v_image[..., :3] = 0 if v_rgb is None else v_rgb
    slopes = Slopes(
        loss=value, photometric=float(value), v_image=v_image, v_alpha=np.zeros_like(alpha),
        v_viewmats=torch.zeros_like(views.viewmats), beside=[], pull=np.empty(0, np.float32),
    )  # fmt: skip
    if terms.networks or terms.penalties:
        leaves = [torch.from_numpy(image).requires_grad_(), torch.from_numpy(alpha).requires_grad_()]
        leaves.append(views.viewmats.detach().requires_grad_())
        _add_networks(slopes, terms, observed(leaves[0], leaves[1], replace(views, viewmats=leaves[2])), target, leaves)
    return slopes


def _add_networks(slopes: Slopes, terms: LossTerms, step: Step, target: Tensor, leaves: list[Tensor]) -> None:
    """Add losses by autograd and the weights of penalties."""
    weights = [w for penalty in terms.penalties if (w := penalty.weights(step)) is not None]
    if weights:
        slopes.pull = torch.stack(weights).sum(0).numpy() if len(weights) > 1 else weights[0].contiguous().numpy()
    first = terms.compare is None
    losses = [loss(step, target) if first and not i else loss(step) for i, loss in enumerate(terms.networks)]
    due = [loss for loss in losses if loss is not None]
    if first and losses[0] is not None:
        slopes.photometric = float(losses[0].detach())
    learning = [p for loss in terms.networks for p in loss.trained_along() if p.requires_grad] if due else []
    total = sum(due, torch.zeros(()))
    gradients: Sequence[Tensor | None] = [None] * (len(leaves) + len(learning))
    if total.requires_grad:
        gradients = torch.autograd.grad(total, [*leaves, *learning], allow_unused=True)
    if not all_finite([total, torch.from_numpy(slopes.pull), *(g for g in gradients if g is not None)]):
        raise OutOfRange
    slopes.loss += np.float32(total.detach())
    own = (torch.from_numpy(slopes.v_image), torch.from_numpy(slopes.v_alpha), slopes.v_viewmats)
    for kept, gradient in zip(own, gradients, strict=False):
        if gradient is not None:
            kept += gradient
    slopes.beside = [(p, g) for p, g in zip(learning, gradients[len(leaves) :], strict=True) if g is not None]
