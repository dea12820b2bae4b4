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

from novags.splats.files.tensors import digest

from ..cpu.memory import clear
from ..gaussians import Gaussians
from ..views import Views
from .checkpoint import TrainingState, load_checkpoint, save_checkpoint
from .companion import Companion
from .config import FitConfig
from .direct import DirectFit
from .flags import EVERY, Flags
from .guard import NotFinite, norms
from .iteration import backpropagate, check_parameters, current, default_photometric, parameters, where
from .pictures import LossTerms
from .step import Step
from .updates.adam import Adam
from .updates.camera_refinement import CameraState, move_cameras
from .updates.mcmc import DEAD_OPACITY, FARTHEST, add_noise, grow, prune_to_cap, relocate

LOG_EVERY = 10  # iterations between entries of FitResult.losses and calls of progress
Progress = Callable[[int, int, dict[str, float]], None]


@dataclass(kw_only=True)
class FitResult:
    """Trained Gaussians and cameras (detached) and their cost.

    Attributes:
        gaussians: The scene.
        viewmats: Training cameras at the end [C, 4, 4]: refined, or as given. The Gaussians belong to them.
        config: How they were trained, with the extent: `config.splatting` shows them as in training.
        losses: One entry per LOG_EVERY iterations and one for the last: "iteration", "loss", "photometric",
            "n_gaussians", and "norm_means", "norm_quats", ...: the Euclidean norm of each tensor of the Gaussians.
        seconds: Wall time, of the stopped runs before this one too.
        earlier: Of these, the seconds of stopped runs before this one.
        kept: Copies of the Gaussians, by the iterations done, as `config.keep_at` asks.
        peak_bytes: Largest resident memory of the process (CPU) or largest allocation (CUDA) so far.
    """

    gaussians: Gaussians
    viewmats: Tensor
    config: FitConfig
    losses: list[dict[str, float]]
    seconds: float
    peak_bytes: int
    earlier: float = 0.0
    kept: dict[int, Gaussians] = field(default_factory=dict)


def fit(
    gaussians: Gaussians,
    views: Views,
    target: Callable[[int], Tensor],
    config: FitConfig,
    *,
    photometric: Callable[[Step, Tensor], Tensor] | None = None,
    extra_losses: Sequence[Callable[[Step], Tensor | None]] = (),
    companion: Companion | None = None,
    before_step: Callable[[int], None] | None = None,
    needs_depth: bool | Callable[[int], bool] = False,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
    flags: Flags | None = None,
) -> FitResult:
    """Fit Gaussians to images by 3DGS-MCMC, on the device of the Gaussians.

    Args:
        gaussians: Start; not changed. More than `cap_max` are pruned, lower SH degrees padded with zeros.
        views: Training cameras, on the same device.
        target: Image [H, W, 3] that view i should show; asked every iteration, so it may change.
        config: How to train.
        photometric: Scalar loss of the Step and its target, which may then be of any shape; None is
            (1 - w) L1 + w (1 - SSIM) with `config.dssim_weight`.
        extra_losses: Called with the Step after rendering; each returns a scalar to add, or None. Where all losses are
            a `PixelLoss`, `PictureLoss` or `HarmonicsPenalty`, the CPU is spared autograd for the Gaussians.
        companion: Parts that the losses use and train beside the Gaussians; changed in place.
        before_step: Called with the iteration number before it starts.
        needs_depth: Render expected depth too; a function is asked in every iteration, by its number.
        progress: Called with (iterations done, of how many, log entry) for each entry of `FitResult.losses`.
        checkpoint: File of the training state. Written every `checkpoint_every` iterations and at the end; if it is
            there already, and of a run with this start, these views and this config (but maybe other targets and
            losses), the run goes on from it. State kept by `target` or the losses is not saved.
        flags: On a GPU, of what `before_step` does too: the fit reads them with its own.

    Returns:
        FitResult.

    Raises:
        ValueError: For a checkpoint of another run, no views, Gaussians that are not float32, views or targets on
            another device, or targets of the wrong shape.
        NotFinite: For a loss, gradient or parameter that is not finite. `checkpoint` then holds the state before that
            iteration, or the last one that was finite: the same call stops at the same place again. On a GPU up to
            `flags.EVERY` iterations later, with everything as it was before that one.
    """
    _check_views(gaussians, views)
    started = time.perf_counter()
    extent = config.extent if config.extent is not None else views.extent
    config = dataclasses.replace(config, extent=extent)
    settings = {} if checkpoint is None else _identity(gaussians, views, config)
    if checkpoint is not None and checkpoint.exists():
        state = load_checkpoint(checkpoint, settings, gaussians.means.device, companion)
        started -= state.seconds
    else:
        state = _initial_state(gaussians, views, config)
        state.companion = companion
    earlier = state.seconds
    cap = config.cap_max if config.cap_max is not None else len(gaussians)
    loss = photometric or partial(default_photometric, config.dssim_weight)
    direct = _direct(state, views, config, extent, LossTerms.of(photometric, extra_losses, config.dssim_weight))
    flags = flags or Flags.on(state.gaussians.means.device)
    save = None if checkpoint is None else partial(_save, checkpoint, settings, started)
    for iteration in range(state.iteration, config.iterations):
        means_rate = config.rates.means_at(iteration, config.iterations, extent)
        rates = config.rates.at(iteration, config.iterations)
        view = config.view_at(iteration, len(views))
        if flags is not None:
            flags.iteration = iteration
        try:
            if before_step is not None:
                _prepare(before_step, iteration)
            losses: tuple[float | Tensor, float | Tensor] | None = None
            aim = target
            with_depth = needs_depth(iteration) if callable(needs_depth) else needs_depth
            if direct is not None:
                image = target(view)
                aim = partial(_same, image)
                if direct.takes(state.gaussians, image, rates):
                    losses = direct.step(state, iteration, image, rates, means_rate, with_depth)
            if losses is None:
                losses = backpropagate(
                    state, views, iteration, config, extent, with_depth=with_depth,
                    photometric=partial(_compare, loss, aim), extra_losses=extra_losses, flags=flags,
                )  # fmt: skip
                # extra losses may reach harmonics that are not rendered yet
                degree = 3 if extra_losses else config.degree_at(iteration)
                good = None if flags is None else flags.good
                state.adam.step(state.gaussians, rates, means_rate, degree, good)
            if companion is not None:
                companion.step(iteration, config.iterations, None if flags is None else flags.bad)
            _move(state, iteration, config, cap, means_rate, extent, flags)
            state.iteration = done = iteration + 1
            if done in config.keep_at:
                state.keep()
            ends, place = done == config.iterations, where(iteration, view)
            saving = done % config.checkpoint_every == 0 or ends
            if done % LOG_EVERY == 0 or ends:
                _log(state, config, losses, progress, place, flags)
            elif saving and flags is None:
                check_parameters(state, place)
            if flags is not None and (done % EVERY == 0 or saving):
                flags.look(parameters(state), place)
                flags.read()
        except NotFinite as stop:
            if flags is not None:  # which held everything as it was before that iteration
                state.iteration = state.adam.count = flags.iteration
            raise _stopped(stop, state, checkpoint, save) from None
        if save is not None and saving:
            save(state)
    clear()  # the blocks of its iterations: as many bytes as there are in its state
    return FitResult(
        gaussians=state.gaussians.detach(), viewmats=current(views, state, extent).viewmats.detach(),
        config=config, losses=state.losses, seconds=time.perf_counter() - started, earlier=earlier,
        peak_bytes=_peak_bytes(state.gaussians), kept=state.kept,
    )  # fmt: skip


def _log(
    state: TrainingState, config: FitConfig, losses: Sequence[float | Tensor], progress: Progress | None, place: str,
    flags: Flags | None,
) -> None:  # fmt: skip
    """Add an entry to the log: now on a CPU, at the next reading on a GPU."""
    done, sizes = state.iteration, norms(state.gaussians.tensors())
    known = {"iteration": float(done), "n_gaussians": float(len(state.gaussians))}
    names = ("loss", "photometric", *sizes)

    def deliver(numbers: Sequence[float]) -> None:
        entry = dict(zip(names, numbers, strict=True))
        order = ("iteration", "loss", "photometric", "n_gaussians", *sizes)
        state.losses.append({name: (known | entry)[name] for name in order})
        if progress is not None:
            progress(done, config.iterations, state.losses[-1])

    if flags is not None:
        flags.keep(torch.stack([*(torch.as_tensor(x) for x in losses), *sizes.values()]), deliver)
        return
    numbers = [float(x) for x in (*losses, *sizes.values())]
    if not math.isfinite(sum(numbers[2:])):
        check_parameters(state, place)
    deliver(numbers)


def _compare(loss: Callable[[Step, Tensor], Tensor], aim: Callable[[int], Tensor], step: Step) -> Tensor:
    return loss(step, aim(step.view))


def _same(image: Tensor, view: int) -> Tensor:
    """The target that was asked for already: it may not be the same the next time."""
    return image


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
    """The error to raise for `stop`, once the state before it is saved; a damaged one must not replace the last good
    one.
    """
    if save is None:
        return stop
    if stop.resumable:
        save(state)
    return NotFinite(f"{stop}; {checkpoint} leads there again", resumable=stop.resumable)


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


def _identity(gaussians: Gaussians, views: Views, config: FitConfig) -> dict[str, object]:
    """The settings of a run, targets and extra losses apart: a checkpoint of another run must not be taken."""
    size = torch.tensor([views.width, views.height])
    return {
        **dataclasses.asdict(config), "views": len(views),
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
    for name, tensor in gaussians.tensors().items():
        if tensor.dtype != torch.float32:
            raise ValueError(f"{name} of the Gaussians must be float32, got {tensor.dtype}: convert it with .float()")
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


def _direct(
    state: TrainingState, views: Views, config: FitConfig, extent: float, terms: LossTerms | None
) -> DirectFit | None:
    """How to do without autograd for the Gaussians, where that is possible."""
    if terms is None or config.backend not in ("auto", "numba") or state.gaussians.means.is_cuda:
        return None
    return DirectFit(views, config, extent, terms)


def _move(
    state: TrainingState, iteration: int, config: FitConfig, cap: int, means_rate: float, extent: float,
    flags: Flags | None,
) -> None:  # fmt: skip
    """Everything that moves after the optimiser step: the population of Gaussians, and cameras; on a GPU masked."""
    state.gaussians = _mcmc_step(
        state.gaussians.detach(), state.adam, iteration, config, cap, means_rate, extent, flags
    )
    if state.cameras is not None and config.refine_cameras is not None:
        factor = config.refine_cameras.factor_at(iteration, config.iterations)
        move_cameras(state.cameras, config.refine_cameras, factor, None if flags is None else flags.good)


def _mcmc_step(
    gaussians: Gaussians, adam: Adam, iteration: int, config: FitConfig, cap: int, means_rate: float, extent: float,
    flags: Flags | None = None,
) -> Gaussians:  # fmt: skip
    """Relocate, grow and shake, after the optimiser step as in gsplat."""
    mcmc = config.mcmc
    if mcmc is None:
        return gaussians
    if mcmc.refine_start < iteration < config.refine_stop and iteration % mcmc.refine_every == 0:
        adam.reset(relocate(gaussians, _generator(config.seed, iteration, 1), _dead(gaussians, flags)))
        goal = min(cap, int(mcmc.growth * len(gaussians)))
        gaussians, drawn = grow(gaussians, goal, _generator(config.seed, iteration, 2))
        adam.reset(drawn)
        adam.grow(gaussians)
    if mcmc.noise_lr:
        stream = _generator(config.seed, iteration, 3)
        rate = mcmc.noise_lr * means_rate / config.unit**2  # times covariances, which are lengths squared
        add_noise(gaussians, rate, stream, limit=FARTHEST * extent, good=None if flags is None else flags.good)
    return gaussians


def _dead(gaussians: Gaussians, flags: Flags | None) -> Tensor | None:
    """On a GPU the indices of the Gaussians that show nothing, whose number is read with the flags.

    Raises:
        NotFinite: After a fault: nothing must be added then.
    """
    if flags is None:
        return None
    dead = gaussians.opacities.detach() <= DEAD_OPACITY
    counts: list[float] = []
    flags.keep(dead.sum()[None], counts.extend)
    flags.read()
    return torch.argsort(dead.to(torch.uint8), descending=True, stable=True)[: int(counts[0])]


def _peak_bytes(gaussians: Gaussians) -> int:
    if gaussians.means.is_cuda:
        return int(torch.cuda.max_memory_allocated(gaussians.means.device))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
