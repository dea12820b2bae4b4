"""One iteration of a fit by autograd, up to the optimiser step: any device, any loss, refined cameras."""

import dataclasses
import operator
from collections.abc import Callable, Sequence
from functools import reduce

import torch
from torch import Tensor

from ..views import Views
from .checkpoint import TrainingState
from .config import FitConfig
from .flags import PARAMETER, Flags
from .guard import NotFinite, require_finite
from .losses import photometric_loss
from .step import Step, render_step
from .updates.activate import activate
from .updates.camera_refinement import refined

ExtraLoss = Callable[[Step], Tensor | None]


def backpropagate(
    state: TrainingState,
    views: Views,
    iteration: int,
    config: FitConfig,
    extent: float,
    *,
    with_depth: bool,
    photometric: Callable[[Step], Tensor],
    extra_losses: Sequence[ExtraLoss],
    flags: Flags | None = None,
) -> tuple[Tensor, Tensor]:
    """Leave gradients in the Gaussians and, where they are refined, in the cameras.

    Returns:
        Loss and its photometric part, scalars.

    Raises:
        NotFinite: For a loss, gradient or parameter that is not finite; with `flags`, they are told instead.
    """
    step, regularizer = _render(state, views, iteration, config, extent, with_depth, flags is not None)
    terms = {"photometric": photometric(step), "regulariser": regularizer}
    terms |= _extra_terms(step, extra_losses)
    loss = reduce(operator.add, terms.values())
    place = where(iteration, step.view)
    if flags is None and not torch.isfinite(loss):
        values = ", ".join(f"{name} {float(term.detach())}" for name, term in terms.items())
        raise NotFinite(f"the loss must be finite, got {float(loss.detach())} {place}: {values}")
    loss.backward()
    if flags is None:
        require_finite("gradient of", _gradients(state), place, resumable=True)
    else:
        found = {PARAMETER + name: tensor for name, tensor in parameters(state).items()}
        found |= {f"the loss {name}": term for name, term in terms.items()}
        flags.look(found | {f"gradient of {name}": t for name, t in _gradients(state).items()}, place)
    return loss.detach(), terms["photometric"].detach()


def _render(
    state: TrainingState, views: Views, iteration: int, config: FitConfig, extent: float, with_depth: bool, known: bool
) -> tuple[Step, Tensor]:
    """This iteration's Step, and the regulariser; `known`: as for `render_step`."""
    gaussians, fused = state.gaussians.requires_grad_(), config.backend != "torch"
    opacity_reg = config.opacity_reg_at(iteration)
    scales, opacities, regularizer = activate(gaussians, opacity_reg, config.scale_reg / config.unit, fused=fused)
    if state.cameras is not None and config.refine_cameras is not None:
        state.cameras.twists.requires_grad_(config.refine_cameras.factor_at(iteration, config.iterations) > 0)
    view = config.view_at(iteration, len(views))
    try:
        step = render_step(
            gaussians, scales, opacities, current(views, state, extent), view=view, iteration=iteration,
            iterations=config.iterations, sh_degree=config.degree_at(iteration), with_depth=with_depth,
            splatting=config.splatting, backend=config.backend, known=known,
        )  # fmt: skip
    except ValueError:
        # The rasteriser refuses Gaussians that the last update has damaged, but knows no iterations.
        check_parameters(state, where(iteration, view))
        raise
    return step, regularizer


def _extra_terms(step: Step, extra_losses: Sequence[ExtraLoss]) -> dict[str, Tensor]:
    """The further terms of the loss that are due, by name; where two have one name, with their number."""
    terms: dict[str, Tensor] = {}
    for number, extra in enumerate(extra_losses):
        term, name = extra(step), getattr(extra, "__name__", type(extra).__name__)
        if term is not None:
            terms[name if name not in terms else f"{name} {number}"] = term
    return terms


def _gradients(state: TrainingState) -> dict[str, Tensor]:
    return {name: tensor.grad for name, tensor in parameters(state).items() if tensor.grad is not None}


def parameters(state: TrainingState) -> dict[str, Tensor]:
    """Everything that is trained, by name."""
    tensors = state.gaussians.tensors()
    if state.cameras is not None:
        tensors = {**tensors, "camera twists": state.cameras.twists}
    if state.companion is not None:
        tensors = {**tensors, **state.companion.named_parameters()}
    return tensors


def check_parameters(state: TrainingState, where: str) -> None:
    """Raise NotFinite for a parameter of Gaussians or cameras that is not finite."""
    require_finite("parameter", parameters(state), where, resumable=False)


def where(iteration: int, view: int) -> str:
    """For messages."""
    return f"at iteration {iteration}, view {view}"


def current(views: Views, state: TrainingState, extent: float) -> Views:
    """The training views with the cameras where they are now, differentiable in their twists."""
    if state.cameras is None:
        return views
    return dataclasses.replace(views, viewmats=refined(views.viewmats, state.cameras.twists, extent))


def default_photometric(dssim_weight: float, step: Step, target: Tensor) -> Tensor:
    """(1 - w) L1 + w (1 - SSIM) of the Step and its target."""
    if target.shape != step.render.shape or target.device != step.render.device:
        raise ValueError(
            f"target({step.view}) must be [H, W, 3] = {list(step.render.shape)} on {step.render.device} as the views, "
            f"got {list(target.shape)} on {target.device}"
        )
    return photometric_loss(step.render, target, dssim_weight)
