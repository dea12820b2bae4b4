"""The one training loop: views, targets and extra losses in, Gaussians out."""

import dataclasses
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from .activate import activate
from .adam import Adam, LearningRates
from .checkpoint import TrainingState, digest, load_checkpoint, save_checkpoint
from .gaussians import Gaussians
from .losses import photometric_loss
from .mcmc import McmcConfig, add_noise, grow, prune_to_cap, relocate
from .rasterize import rasterize
from .views import Views

Info = dict[str, Tensor]
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
        extent: Scene size that the rate of the means is relative to, world units; None is measured from the cameras.
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
class Step:
    """One iteration as extra losses see it; `render`, `alpha` and `depth` are differentiable.

    Attributes:
        iteration: From 0.
        iterations: Of the whole run.
        view: Index of this iteration's training view.
        gaussians: The trained leaves.
        render: [H, W, 3].
        alpha: [H, W].
        info: "means2d" [N, 2], "radii" [N], "depths" [N] of this view.
        views: All training views.
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
    rasterize_view: Callable[[int], tuple[Tensor, Tensor, Tensor, Info]]
    expected_depth: Tensor | None

    @property
    def depth(self) -> Tensor:
        """Expected depth [H, W], world units, 0 where nothing was hit.

        Raises:
            ValueError: If the fit was not asked for depth in this iteration.
        """
        if self.expected_depth is None:
            raise ValueError(
                f"depth was not rendered in iteration {self.iteration}: call fit(..., needs_depth=True), or a function "
                "of the iteration that says so"
            )
        return self.expected_depth


@dataclass(kw_only=True)
class FitResult:
    """Trained Gaussians (detached) and what they cost.

    Attributes:
        gaussians: The scene.
        losses: One entry per LOG_EVERY iterations: "iteration", "loss", "photometric", "n_gaussians".
        seconds: Wall time, of the stopped runs before this one too.
        peak_bytes: Largest resident memory of the process (CPU) or largest allocation (CUDA) so far.
    """

    gaussians: Gaussians
    losses: list[dict[str, float]]
    seconds: float
    peak_bytes: int


def fit(
    gaussians: Gaussians,
    views: Views,
    target: Callable[[int], Tensor],
    config: FitConfig,
    *,
    extra_losses: Sequence[Callable[[Step], Tensor | None]] = (),
    before_step: Callable[[int], None] | None = None,
    needs_depth: bool | Callable[[int], bool] = False,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
    checkpoint: Path | None = None,
) -> FitResult:
    """Fit Gaussians to images by 3DGS-MCMC.

    Args:
        gaussians: Start; not changed. More than `cap_max` are pruned, lower SH degrees padded with zeros.
        views: Training cameras.
        target: Image [H, W, 3] that view i should show; asked every iteration, so it may change.
        config: How to train.
        extra_losses: Called with the Step after rendering; each returns a scalar to add, or None.
        before_step: Called with the iteration number before it starts.
        needs_depth: Render expected depth too; a function is asked in every iteration, by its number.
        progress: Called every LOG_EVERY iterations with (iterations done, of how many, log entry).
        checkpoint: File of the training state. Written every `checkpoint_every` iterations and at the end; if it is
            there already, and of a run with this start, these views and this config (but maybe other targets), the
            run goes on from it. State that `target` and `extra_losses` keep is theirs to save.

    Returns:
        FitResult.

    Raises:
        ValueError: For a checkpoint of another run, no views, targets of the wrong shape, or a loss that is not finite.
    """
    if len(views) == 0:
        raise ValueError("views must hold at least one camera, got none")
    started = time.perf_counter()
    extent = config.extent if config.extent is not None else views.extent
    settings = {} if checkpoint is None else _identity(gaussians, views, config, extent)
    if checkpoint is not None and checkpoint.exists():
        state = load_checkpoint(checkpoint, settings, gaussians.means.device)
        started -= state.seconds
    else:
        start = _prepared(gaussians, config)
        state = TrainingState(gaussians=start, adam=Adam(start))
    cap = config.cap_max if config.cap_max is not None else len(gaussians)
    for iteration in range(state.iteration, config.iterations):
        if before_step is not None:
            before_step(iteration)
        with_depth = needs_depth(iteration) if callable(needs_depth) else needs_depth
        step, regularizer = _render_step(state.gaussians.requires_grad_(), views, iteration, config, with_depth)
        loss, photometric = _loss(step, regularizer, target(step.view), config, extra_losses)
        loss.backward()
        means_rate = config.rates.means_at(iteration, config.iterations, extent)
        # extra losses may reach harmonics that are not rendered yet
        degree = 3 if extra_losses else _degree_at(iteration, config)
        state.adam.step(state.gaussians, config.rates, means_rate, degree)
        state.gaussians = _mcmc_step(state.gaussians.detach(), state.adam, iteration, config, cap, means_rate)
        state.iteration = done = iteration + 1
        if done % LOG_EVERY == 0 or done == config.iterations:
            entry = {"iteration": float(done), "loss": float(loss.detach()), "photometric": photometric}
            state.losses.append({**entry, "n_gaussians": float(len(state.gaussians))})
            if progress is not None:
                progress(done, config.iterations, state.losses[-1])
        if checkpoint is not None and (done % config.checkpoint_every == 0 or done == config.iterations):
            state.seconds = time.perf_counter() - started
            save_checkpoint(checkpoint, state, settings)
    return FitResult(
        gaussians=state.gaussians.detach(), losses=state.losses, seconds=time.perf_counter() - started,
        peak_bytes=_peak_bytes(state.gaussians),
    )  # fmt: skip


def _identity(gaussians: Gaussians, views: Views, config: FitConfig, extent: float) -> dict[str, object]:
    """What a run is started with, targets and extra losses apart: a checkpoint of another run must not be taken."""
    size = torch.tensor([views.width, views.height])
    return {
        **dataclasses.asdict(config), "extent": extent, "views": len(views),
        "start": digest(*gaussians.tensors().values()), "cameras": digest(views.viewmats, views.Ks, size),
    }  # fmt: skip


def _prepared(gaussians: Gaussians, config: FitConfig) -> Gaussians:
    """A copy of the initial Gaussians with room for the SH degree and no more of them than the cap."""
    if len(gaussians) == 0:
        raise ValueError("fit needs at least one Gaussian to start from, got none")
    layout = torch.contiguous_format  # a clone keeps the strides else, and the optimiser works in place
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


def _render_step(
    gaussians: Gaussians, views: Views, iteration: int, config: FitConfig, with_depth: bool
) -> tuple[Step, Tensor]:
    """This iteration's Step, and the regulariser."""
    fused = config.backend != "torch"
    scales, opacities, regularizer = activate(gaussians, config.opacity_reg, config.scale_reg, fused=fused)
    degree = _degree_at(iteration, config)

    def render(j: int, mode: str) -> tuple[Tensor, Tensor, Info]:
        renders, alphas, info = rasterize(
            gaussians.means, gaussians.quats, scales, opacities, gaussians.sh, views.viewmats[j : j + 1],
            views.Ks[j : j + 1], views.width, views.height, sh_degree=degree, render_mode=mode, backend=config.backend,
        )  # fmt: skip
        return renders[0], alphas[0, ..., 0], {key: value[0] for key, value in info.items()}

    def rasterize_view(j: int) -> tuple[Tensor, Tensor, Tensor, Info]:
        image, alpha, info = render(j, "RGB+ED")
        return image[..., :3], image[..., 3], alpha, info

    view = _view_at(iteration, len(views), config.seed)
    image, alpha, info = render(view, "RGB+ED" if with_depth else "RGB")
    step = Step(
        iteration=iteration, iterations=config.iterations, view=view, gaussians=gaussians, render=image[..., :3],
        alpha=alpha, info=info, views=views, rasterize_view=rasterize_view,
        expected_depth=image[..., 3] if with_depth else None,
    )  # fmt: skip
    return step, regularizer


def _loss(
    step: Step,
    regularizer: Tensor,
    target: Tensor,
    config: FitConfig,
    extra_losses: Sequence[Callable[[Step], Tensor | None]],
) -> tuple[Tensor, float]:
    """Total loss, and its photometric part as a number."""
    if target.shape != step.render.shape:
        raise ValueError(
            f"target({step.view}) must be [H, W, 3] = {list(step.render.shape)} as in views, got {list(target.shape)}"
        )
    photometric = photometric_loss(step.render, target, config.dssim_weight)
    loss = photometric + regularizer
    for extra in extra_losses:
        term = extra(step)
        loss = loss if term is None else loss + term
    if not torch.isfinite(loss):
        raise ValueError(
            f"the loss must be finite, got {float(loss.detach())} at iteration {step.iteration}, view {step.view}"
        )
    return loss, float(photometric.detach())


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
        return int(torch.cuda.max_memory_allocated())
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
