"""The one training loop: views, targets and extra losses in, Gaussians out."""

import dataclasses
import math
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..gaussians import Gaussians
from ..views import Views
from .activate import activate
from .adam import Adam, LearningRates
from .camera_refinement import CameraRefinement, CameraState, move_cameras, refined
from .checkpoint import TrainingState, digest, load_checkpoint, save_checkpoint
from .guard import NotFinite, norms, require_finite
from .losses import photometric_loss
from .mcmc import McmcConfig, add_noise, grow, prune_to_cap, relocate
from .step import Step, render_step

LOG_EVERY = 10  # iterations between entries of FitResult.losses and calls of progress


@dataclass(frozen=True, kw_only=True)
class FitConfig:
    """How to train.

    Attributes:
        iterations: Optimiser steps.
        cap_max: Largest number of Gaussians; None is as many as there are at the start.
        sh_degree: Highest spherical-harmonics degree, 0..3.
        sh_every: Iterations between two steps of the degree, from 0.
        dssim_weight: w in (1 - w) L1 + w (1 - SSIM); 0 is L1 alone.
        opacity_reg: Weight of the mean opacity.
        scale_reg: Weight of the mean scale.
        rates: Learning rates.
        mcmc: When Gaussians move; None keeps the population as it is.
        refine_cameras: How the training cameras are refined; None takes them as they are given.
        extent: Scene size that the rates of the means and of the cameras are relative to, world units; None is measured
            from the cameras.
        seed: Of the order of views, of relocation and of noise.
        backend: As in `rasterize`.
        checkpoint_every: Iterations between checkpoints.
    """

    iterations: int = 7000
    cap_max: int | None = None
    sh_degree: int = 3
    sh_every: int = 1000
    dssim_weight: float = 0.2
    opacity_reg: float = 0.01
    scale_reg: float = 0.01
    rates: LearningRates = field(default_factory=LearningRates)
    mcmc: McmcConfig | None = field(default_factory=McmcConfig)
    refine_cameras: CameraRefinement | None = None
    extent: float | None = None
    seed: int = 0
    backend: str = "auto"
    checkpoint_every: int = 1000

    def __post_init__(self) -> None:
        if self.iterations < 0 or self.sh_every < 1 or self.checkpoint_every < 1:
            raise ValueError(
                "iterations must be >= 0, sh_every and checkpoint_every >= 1, got "
                f"{self.iterations}, {self.sh_every} and {self.checkpoint_every}"
            )
        if self.cap_max is not None and self.cap_max < 1:
            raise ValueError(f"cap_max must be >= 1 or None, got {self.cap_max}")
        if self.sh_degree not in (0, 1, 2, 3):
            raise ValueError(f"sh_degree must be 0, 1, 2 or 3, got {self.sh_degree}")
        if not 0 <= self.dssim_weight <= 1 or self.opacity_reg < 0 or self.scale_reg < 0:
            raise ValueError(
                "dssim_weight must lie in 0..1 and the regularisers be >= 0, got "
                f"{self.dssim_weight}, {self.opacity_reg} and {self.scale_reg}"
            )
        if self.extent is not None and not self.extent > 0:
            raise ValueError(f"extent must be > 0 or None, got {self.extent}")


@dataclass(kw_only=True)
class FitResult:
    """Trained Gaussians and cameras (detached) and what they cost.

    Attributes:
        gaussians: The scene.
        viewmats: Training cameras at the end [C, 4, 4]: refined, or as they were given. The Gaussians belong to them.
        losses: One entry per LOG_EVERY iterations: "iteration", "loss", "photometric", "n_gaussians", and "norm_means",
            "norm_quats", ...: the Euclidean norm of each tensor of the Gaussians.
        seconds: Wall time, of the stopped runs before this one too.
        peak_bytes: Largest resident memory of the process (CPU) or largest allocation (CUDA) so far.
    """

    gaussians: Gaussians
    viewmats: Tensor
    losses: list[dict[str, float]]
    seconds: float
    peak_bytes: int


def fit(
    gaussians: Gaussians,
    views: Views,
    target: Callable[[int], Tensor],
    config: FitConfig,
    *,
    photometric: Callable[[Step, Tensor], Tensor] | None = None,
    extra_losses: Sequence[Callable[[Step], Tensor | None]] = (),
    before_step: Callable[[int], None] | None = None,
    needs_depth: bool | Callable[[int], bool] = False,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
    checkpoint: Path | None = None,
) -> FitResult:
    """Fit Gaussians to images by 3DGS-MCMC, on the device of the Gaussians.

    Args:
        gaussians: Start; not changed. More than `cap_max` are pruned, lower SH degrees padded with zeros.
        views: Training cameras, on the same device.
        target: Image [H, W, 3] that view i should show; asked every iteration, so it may change.
        config: How to train.
        photometric: Scalar loss of the Step and its target, which may then be of any shape; None is
            (1 - w) L1 + w (1 - SSIM) with `config.dssim_weight`.
        extra_losses: Called with the Step after rendering; each returns a scalar to add, or None.
        before_step: Called with the iteration number before it starts.
        needs_depth: Render expected depth too; a function is asked in every iteration, by its number.
        progress: Called every LOG_EVERY iterations with (iterations done, of how many, log entry).
        checkpoint: File of the training state. Written every `checkpoint_every` iterations and at the end; if it is
            there already, and of a run with this start, these views and this config (but maybe other targets and
            losses), the run goes on from it. State kept by `target` or the losses is not saved.

    Returns:
        FitResult.

    Raises:
        ValueError: For a checkpoint of another run, no views, views or targets on another device, or targets of the
            wrong shape.
        NotFinite: For a loss, gradient or parameter that is not finite. `checkpoint` then holds the state before that
            iteration, or the last one that was finite: the same call stops at the same place again.
    """
    _check_views(gaussians, views)
    started = time.perf_counter()
    extent = config.extent if config.extent is not None else views.extent
    settings = {} if checkpoint is None else _identity(gaussians, views, config, extent)
    if checkpoint is not None and checkpoint.exists():
        state = load_checkpoint(checkpoint, settings, gaussians.means.device)
        started -= state.seconds
    else:
        state = _initial_state(gaussians, views, config)
    cap = config.cap_max if config.cap_max is not None else len(gaussians)
    compare = photometric or partial(_default_photometric, config.dssim_weight)
    save = None if checkpoint is None else partial(_save, checkpoint, settings, started)
    for iteration in range(state.iteration, config.iterations):
        try:
            if before_step is not None:
                _prepare(before_step, iteration)
            with_depth = needs_depth(iteration) if callable(needs_depth) else needs_depth
            step, regularizer = _render(state, views, iteration, config, extent, with_depth)
            loss, part = _loss(step, regularizer, compare(step, target(step.view)), extra_losses)
            loss.backward()
            require_finite("gradient of", _gradients(state), _where(iteration, step.view), resumable=True)
            # extra losses may reach harmonics that are not rendered yet
            degree = 3 if extra_losses else _degree_at(iteration, config)
            _update(state, iteration, config, cap, extent, degree)
            state.iteration = done = iteration + 1
            saving = done % config.checkpoint_every == 0 or done == config.iterations
            if done % LOG_EVERY == 0 or saving:
                sizes = norms(state.gaussians.tensors())
                if not math.isfinite(sum(sizes.values())):
                    _check_parameters(state, _where(iteration, step.view))
        except NotFinite as stop:
            raise _stopped(stop, state, checkpoint, save) from None
        if done % LOG_EVERY == 0 or done == config.iterations:
            entry = {"iteration": float(done), "loss": float(loss.detach()), "photometric": part}
            state.losses.append({**entry, "n_gaussians": float(len(state.gaussians)), **sizes})
            if progress is not None:
                progress(done, config.iterations, state.losses[-1])
        if save is not None and saving:
            save(state)
    return FitResult(
        gaussians=state.gaussians.detach(), viewmats=_current(views, state, extent).viewmats.detach(),
        losses=state.losses, seconds=time.perf_counter() - started, peak_bytes=_peak_bytes(state.gaussians),
    )  # fmt: skip


def _prepare(before_step: Callable[[int], None], iteration: int) -> None:
    try:
        before_step(iteration)
    except NotFinite as stop:
        raise NotFinite(f"{stop} before iteration {iteration}", resumable=stop.resumable) from None


def _save(path: Path, settings: dict[str, object], started: float, state: TrainingState) -> None:
    state.seconds = time.perf_counter() - started
    save_checkpoint(path, state, settings)


def _stopped(
    stop: NotFinite, state: TrainingState, checkpoint: Path | None, save: Callable[[TrainingState], None] | None
) -> NotFinite:
    """What to raise for `stop`, once the state before it is saved; a damaged one must not replace the last good one."""
    if save is None:
        return stop
    if stop.resumable:
        save(state)
    return NotFinite(f"{stop}; {checkpoint} leads there again", resumable=stop.resumable)


def _where(iteration: int, view: int) -> str:
    return f"at iteration {iteration}, view {view}"


def _gradients(state: TrainingState) -> dict[str, Tensor]:
    leaves = state.gaussians.tensors()
    if state.cameras is not None:
        leaves = {**leaves, "camera twists": state.cameras.twists}
    return {name: tensor.grad for name, tensor in leaves.items() if tensor.grad is not None}


def _check_parameters(state: TrainingState, where: str) -> None:
    tensors = state.gaussians.tensors()
    if state.cameras is not None:
        tensors = {**tensors, "camera twists": state.cameras.twists}
    require_finite("parameter", tensors, where, resumable=False)


def _check_views(gaussians: Gaussians, views: Views) -> None:
    if len(views) == 0:
        raise ValueError("views must hold at least one camera, got none")
    device = gaussians.means.device
    for name, tensor in (("viewmats", views.viewmats), ("Ks", views.Ks)):
        if tensor.device != device:
            raise ValueError(
                f"views and Gaussians must be on one device, got {name} on {tensor.device} and Gaussians on {device}: "
                "move either with .to(device)"
            )


def _identity(gaussians: Gaussians, views: Views, config: FitConfig, extent: float) -> dict[str, object]:
    """What a run is started with, targets and extra losses apart: a checkpoint of another run must not be taken."""
    size = torch.tensor([views.width, views.height])
    return {
        **dataclasses.asdict(config), "extent": extent, "views": len(views),
        "start": digest(*gaussians.tensors().values()), "cameras": digest(views.viewmats, views.Ks, size),
    }  # fmt: skip


def _initial_state(gaussians: Gaussians, views: Views, config: FitConfig) -> TrainingState:
    start = _prepared(gaussians, config)
    cameras = None if config.refine_cameras is None else CameraState.of(views.viewmats)
    return TrainingState(gaussians=start, adam=Adam(start), cameras=cameras)


def _prepared(gaussians: Gaussians, config: FitConfig) -> Gaussians:
    """A copy of the initial Gaussians with room for the SH degree, at most as many as the cap."""
    if len(gaussians) == 0:
        raise ValueError("fit needs at least one Gaussian to start from, got none")
    layout = torch.contiguous_format  # a plain clone keeps the strides, but the optimiser works in place
    copies = {name: t.detach().clone(memory_format=layout) for name, t in gaussians.tensors().items()}
    gaussians = Gaussians(**copies)
    if config.cap_max is not None:
        gaussians = prune_to_cap(gaussians, config.cap_max, _generator(config.seed, 0, 0))
    k = (config.sh_degree + 1) ** 2
    sh = gaussians.sh[:, :k]
    gaussians.sh = torch.cat([sh, sh.new_zeros(len(sh), k - sh.shape[1], 3)], dim=1)
    return gaussians


def _generator(seed: int, iteration: int, what: int) -> torch.Generator:
    """A stream for one purpose in one iteration: nothing to save in a checkpoint, nothing shared between purposes."""
    state = np.random.SeedSequence([seed, iteration, what]).generate_state(1, np.uint64)[0]
    return torch.Generator().manual_seed(int(state) & (2**63 - 1))


def _degree_at(iteration: int, config: FitConfig) -> int:
    return min(config.sh_degree, iteration // config.sh_every)


def _view_at(iteration: int, n_views: int, seed: int) -> int:
    """Every epoch visits all views once, in a new random order."""
    epoch, position = divmod(iteration, n_views)
    return int(np.random.default_rng([seed, epoch]).permutation(n_views)[position])


def _current(views: Views, state: TrainingState, extent: float) -> Views:
    """The training views with the cameras where they are now, differentiable in their twists."""
    if state.cameras is None:
        return views
    return dataclasses.replace(views, viewmats=refined(views.viewmats, state.cameras.twists, extent))


def _render(
    state: TrainingState, views: Views, iteration: int, config: FitConfig, extent: float, with_depth: bool
) -> tuple[Step, Tensor]:
    """This iteration's Step, and the regulariser."""
    gaussians, fused = state.gaussians.requires_grad_(), config.backend != "torch"
    scales, opacities, regularizer = activate(gaussians, config.opacity_reg, config.scale_reg, fused=fused)
    if state.cameras is not None and config.refine_cameras is not None:
        state.cameras.twists.requires_grad_(config.refine_cameras.factor_at(iteration, config.iterations) > 0)
    view = _view_at(iteration, len(views), config.seed)
    try:
        step = render_step(
            gaussians, scales, opacities, _current(views, state, extent), view=view, iteration=iteration,
            iterations=config.iterations, sh_degree=_degree_at(iteration, config), with_depth=with_depth,
            backend=config.backend,
        )  # fmt: skip
    except ValueError:
        # The rasteriser refuses Gaussians that the last update has damaged, but knows no iterations.
        _check_parameters(state, _where(iteration, view))
        raise
    return step, regularizer


def _default_photometric(dssim_weight: float, step: Step, target: Tensor) -> Tensor:
    if target.shape != step.render.shape or target.device != step.render.device:
        raise ValueError(
            f"target({step.view}) must be [H, W, 3] = {list(step.render.shape)} on {step.render.device} as the views, "
            f"got {list(target.shape)} on {target.device}"
        )
    return photometric_loss(step.render, target, dssim_weight)


def _loss(
    step: Step, regularizer: Tensor, photometric: Tensor, extra_losses: Sequence[Callable[[Step], Tensor | None]]
) -> tuple[Tensor, float]:
    """Total loss, and its photometric part as a number."""
    terms = {"photometric": photometric, "regulariser": regularizer}
    loss = photometric + regularizer
    for extra in extra_losses:
        term = extra(step)
        if term is not None:
            terms[getattr(extra, "__name__", type(extra).__name__)] = term
            loss = loss + term
    if not torch.isfinite(loss):
        values = ", ".join(f"{name} {float(term.detach())}" for name, term in terms.items())
        where = _where(step.iteration, step.view)
        raise NotFinite(f"the loss must be finite, got {float(loss.detach())} {where}: {values}")
    return loss, float(photometric.detach())


def _update(state: TrainingState, iteration: int, config: FitConfig, cap: int, extent: float, sh_degree: int) -> None:
    """Everything that moves after the backward pass: Gaussians, their population, cameras."""
    means_rate = config.rates.means_at(iteration, config.iterations, extent)
    state.adam.step(state.gaussians, config.rates, means_rate, sh_degree)
    state.gaussians = _mcmc_step(state.gaussians.detach(), state.adam, iteration, config, cap, means_rate)
    if state.cameras is not None and config.refine_cameras is not None:
        factor = config.refine_cameras.factor_at(iteration, config.iterations)
        move_cameras(state.cameras, config.refine_cameras, factor)


def _mcmc_step(
    gaussians: Gaussians, adam: Adam, iteration: int, config: FitConfig, cap: int, means_rate: float
) -> Gaussians:
    """Relocate, grow and shake, after the optimiser step as in gsplat."""
    mcmc = config.mcmc
    if mcmc is None:
        return gaussians
    stop = mcmc.refine_stop if mcmc.refine_stop is not None else config.iterations * 5 // 6
    if mcmc.refine_start < iteration < stop and iteration % mcmc.refine_every == 0:
        adam.reset(relocate(gaussians, _generator(config.seed, iteration, 1)))
        goal = min(cap, int(mcmc.growth * len(gaussians)))
        gaussians, drawn = grow(gaussians, goal, _generator(config.seed, iteration, 2))
        adam.reset(drawn)
        adam.grow(gaussians)
    if mcmc.noise_lr:
        add_noise(gaussians, mcmc.noise_lr * means_rate, _generator(config.seed, iteration, 3))
    return gaussians


def _peak_bytes(gaussians: Gaussians) -> int:
    if gaussians.means.is_cuda:
        return int(torch.cuda.max_memory_allocated(gaussians.means.device))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
