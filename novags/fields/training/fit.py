"""The training loop of fields: views and a loss in, a field out."""

import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from novags.fields.box import Box
from novags.fields.evaluate import basis_of, evaluate, gradients
from novags.fields.field import Field, first_field
from novags.fields.layout import SIDE
from novags.fields.march import Proposal, cells_near, rays_of, sampled, weights_of
from novags.fields.training.anchors import Anchors, PointLoss
from novags.fields.training.batch import Batch, chosen_pixels, distortion
from novags.fields.training.checkpoint import FieldState, load_state, save_state
from novags.fields.training.config import FieldFitConfig
from novags.splats.cpu.parallel import run
from novags.splats.cpu.training import optimizer
from novags.splats.files.tensors import digest
from novags.splats.training.guard import NotFinite, norms
from novags.splats.training.updates.adam import Adam
from novags.splats.views import Views

LOG_EVERY = 10
REFRESH = 8  # steps between two updates of cells of the map that rays may not have met
KEPT_WHEN_MET, KEPT_WHEN_LOOKED_AT = 0.9, 0.5  # share that a map cell keeps of its excess over the density found in it
POINT_DENSITY = 10.0  # of the map at first points: opaque within a few cells

Loss = Callable[[Batch], Tensor]
Progress = Callable[[int, int, dict[str, float]], None]


@dataclass(frozen=True, kw_only=True)
class FieldFit:
    """A trained field: see `FieldState`, the wall time including stopped runs before this one, and the time of these
    runs alone.
    """

    state: FieldState
    seconds: float
    earlier: float


def fit_field(
    views: Views,
    points: Tensor,
    box: Box,
    loss: Loss,
    config: FieldFitConfig,
    *,
    at_points: PointLoss | None = None,
    extra: Mapping[str, Tensor] | None = None,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
) -> FieldFit:
    """Fit a field, on the CPU.

    Args:
        views: Training cameras, on the CPU.
        points: First points of the scene [P, 3].
        box: Where the field is; see `box_of`.
        loss: Scalar loss of a Batch, to which the distortion is added.
        config: How to train.
        at_points: Scalar loss of (which of the points [n], the field's outputs there [n, K]), with `config.anchored` as
            its weight; None: rays alone decide on the field.
        extra: Further tensors to be trained, by name, at their start; the loss reads what `fit_field` has trained from
            these same tensors, which it changes in place.
        progress: Called every LOG_EVERY steps and at the end with (steps done, of how many, log entry).
        checkpoint: File of the training state; see `splats.fit`.

    Raises:
        ValueError: For no views, views on another device, or a checkpoint of another run.
        NotFinite: For a loss or a gradient that is not finite; `checkpoint` then holds the state before that step.
    """
    if not len(views) or views.viewmats.device.type != "cpu":
        raise ValueError(
            f"a field is fitted to at least one view on the CPU, got {len(views)} on {views.viewmats.device}"
        )
    started, more = time.perf_counter(), dict(extra or {})
    settings = _identity(views, points, box, config, more)
    if checkpoint is not None and checkpoint.exists():
        state = load_state(checkpoint, settings, config.layout, more)
        started -= state.seconds
    else:
        state = _first_state(points, box, config, more)
    earlier = state.seconds
    anchors = Anchors.at(points, box, at_points, config.anchored) if at_points and config.anchored else None
    for iteration in range(state.iteration, config.iterations):
        try:
            value = _step(state, views, box, loss, anchors, config, iteration)
        except NotFinite as stop:
            if checkpoint is None:
                raise
            state.seconds = time.perf_counter() - started
            save_state(checkpoint, state, settings)
            raise NotFinite(f"{stop}; {checkpoint} leads there again") from None
        state.iteration = done = iteration + 1
        if done % LOG_EVERY == 0 or done == config.iterations:
            sizes = {name: float(norm) for name, norm in norms(state.tensors()).items()}
            state.losses.append({"iteration": float(done), "loss": value, **sizes})
            if progress is not None:
                progress(done, config.iterations, state.losses[-1])
        if checkpoint is not None and (done % config.checkpoint_every == 0 or done == config.iterations):
            state.seconds = time.perf_counter() - started
            save_state(checkpoint, state, settings)
    return FieldFit(state=state, seconds=time.perf_counter() - started, earlier=earlier)


def _identity(
    views: Views, points: Tensor, box: Box, config: FieldFitConfig, extra: Mapping[str, Tensor]
) -> dict[str, object]:
    size = torch.tensor([views.width, views.height])
    return {
        **dataclasses.asdict(config), "box": box.record(), "points": digest(points),
        "cameras": digest(views.viewmats, views.Ks, size), "extra": digest(*extra.values()),
    }  # fmt: skip


def _first_state(points: Tensor, box: Box, config: FieldFitConfig, extra: dict[str, Tensor]) -> FieldState:
    near, proposal = cells_near(points, box) if config.points else None, Proposal()
    if near is not None:
        proposal.density[near] = POINT_DENSITY
    return FieldState.of(first_field(config.layout, config.seed, near), proposal, extra)


def _step(
    state: FieldState, views: Views, box: Box, loss: Loss, anchors: Anchors | None, config: FieldFitConfig,
    iteration: int,
) -> float:  # fmt: skip
    """One step; a step that raises NotFinite leaves the state unchanged, the map of densities too."""
    rng, looked, mapped = np.random.default_rng([config.seed, iteration, 0xBA7C4]), state.looked, None
    if iteration % REFRESH == 0:
        mapped = state.proposal.density.copy()
        refresh(state, rng, config.rays * config.samples // 2)
    try:
        found, slopes, places, density = _found(state, views, box, loss, anchors, config, iteration, rng)
    except NotFinite:
        if mapped is not None:
            state.proposal.density[:], state.looked = mapped, looked
        raise
    state.proposal.learn(places, density, KEPT_WHEN_MET)
    _update(state, slopes, config.rate_at(iteration))
    return found


def _found(
    state: FieldState, views: Views, box: Box, loss: Loss, anchors: Anchors | None, config: FieldFitConfig,
    iteration: int, rng: np.random.Generator,
) -> tuple[float, dict[str, np.ndarray], np.ndarray, np.ndarray]:  # fmt: skip
    """The loss, its gradients by tensor, and the places of the samples with the logarithm of the density there."""
    view, x, y = chosen_pixels(views, config.rays, config.patch, rng)
    rays = rays_of(views, view, x, y)
    jitter = rng.random((config.rays, config.samples + 1), np.float32)
    samples = sampled(rays, box, state.proposal, jitter, config.even)
    basis = basis_of(rays.directions)
    flat, encoded = evaluate(state.field, samples.positions, basis)
    raw = torch.from_numpy(flat).reshape(config.rays, config.samples, -1).requires_grad_()
    for tensor in state.extra.values():
        tensor.requires_grad_().grad = None
    weights = weights_of(raw[..., 0], samples.widths)
    value = loss(Batch(iteration, view, x, y, config.patch, rays, samples, raw, weights))
    if config.distortion:
        # Distances beyond the box count as its end, for the sky may be anywhere there. Widths count in full: that keeps
        # haze from far away, and without it the depth of busts is wrong by 2.8 instead of 2.4 %.
        along = samples.distances.clamp_max(box.middle) / box.middle
        value = value + config.distortion * distortion(weights, along, samples.widths * (box.unit / box.middle))
    found = float(value.detach())
    if not math.isfinite(found):
        raise NotFinite(f"the loss must be finite, got {found} in step {iteration}: lower the learning rate")
    value.backward()
    assert raw.grad is not None
    if config.near_scale:
        raw.grad *= (samples.distances / (config.near_scale * box.middle)).square().clamp_max(1)[..., None]
    slopes = gradients(
        state.field, samples.positions, basis, encoded, raw.grad.reshape(len(flat), -1).contiguous().numpy()
    )
    if anchors is not None:
        there = anchors.slopes(state.field, rng)
        slopes = {name: slope + there[name] for name, slope in slopes.items()}
    if config.table_decay:
        slopes["table"] = slopes["table"] + table_decay_slope(state.field, config.table_decay)
    slopes |= {name: t.grad.numpy() for name, t in state.extra.items() if t.grad is not None}
    if not math.isfinite(sum(float(np.abs(slope).sum()) for name, slope in slopes.items() if name != "table")):
        raise NotFinite(f"the gradient must be finite, and is not in step {iteration}: lower the learning rate")
    return found, slopes, samples.positions, flat[:, 0]


def table_decay_slope(field: Field, weight: float) -> np.ndarray:
    """Gradient [rows, features] of `weight` times the mean over levels of the mean squared feature of a level."""
    table, sizes = field.table.detach().numpy(), np.diff(field.layout.starts)
    each = np.repeat(2 * weight / (len(sizes) * sizes * table.shape[1]), sizes).astype(np.float32)
    return np.asarray(each[:, None] * table)


def _update(state: FieldState, slopes: Mapping[str, np.ndarray], rate: float) -> None:
    """One step of Adam for all tensors."""
    state.steps += 1
    numbers = Adam.numbers(state.steps)
    for name, tensor in state.tensors().items():
        if name in slopes:
            arrays = (tensor.detach().numpy(), slopes[name], state.first[name].numpy(), state.second[name].numpy())
            run(optimizer.adam, tensor.numel(), 4096, *(a.reshape(-1) for a in arrays), np.float32(rate), *numbers)


def refresh(state: FieldState, rng: np.random.Generator, count: int) -> None:
    """Evaluate the field in the next `count` cells of the map, each at a random place, and update them."""
    cells = SIDE**3
    begin = state.looked % cells
    chosen = np.arange(begin, begin + min(count, cells)) % cells
    state.looked = int((begin + len(chosen)) % cells)
    corner = np.stack([chosen % SIDE, chosen // SIDE % SIDE, chosen // SIDE**2], -1)
    places = ((corner + rng.random((len(chosen), 3))) / SIDE).astype(np.float32)
    raw, _ = evaluate(state.field, places, np.array([[1, 0, 0, 0]], np.float32))
    state.proposal.learn(places, raw[:, 0], KEPT_WHEN_LOOKED_AT)
