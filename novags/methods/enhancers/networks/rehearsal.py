"""A network learns from the dark pictures of a scene alone, step by step; it can be interrupted and goes on."""

import dataclasses
import hashlib
import json
import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from novags.methods.enhancers.networks.kind import Kind, crops
from novags.splats.files.tensors import digest, read, write_tensors
from novags.splats.training.companion import masked_step, pack, unpack
from novags.splats.training.flags import Flags, tell

Progress = Callable[[int, int, dict[str, float]], None]
SAVED = 60.0  # s between two checkpoints


def learned(
    kind: Kind,
    config: Any,
    pictures: Tensor,
    seed: int,
    *,
    progress: Progress | None = None,
    more: int = 0,
    checkpoint: Path | None = None,
) -> tuple[nn.Module, float]:
    """A network that has learned from these pictures, ready to enhance; the seconds of stopped runs before this one.

    Args:
        kind: Of the network; one that can learn so.
        config: Of the enhancer.
        pictures: [C, H, W, 3], sRGB-encoded in 0..1.
        seed: Of the first weights and of the crops; the draws of a step depend on it and on the step's number alone.
        progress: Called after every step with (steps done, of how many, {"enhancer": loss}).
        more: Steps that are to follow after these, for `progress`.
        checkpoint: Where the state is kept, and continued from. It stays when the training is over.

    Raises:
        ValueError: If the loss is not finite, or the checkpoint is damaged or belongs to another run.
    """
    rehearsal = kind.rehearsal
    assert rehearsal is not None
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = kind.make(config).to(pictures.device)
    adam = rehearsal.optimizer(network, config)
    steps, run = rehearsal.steps(config), _identity(kind, config, pictures, seed)
    step, earlier = 0, 0.0
    if checkpoint is not None and checkpoint.exists():
        step, earlier = _restored(checkpoint, network, adam, run)

    def report(step: int, loss: float) -> None:
        if progress is not None:
            progress(step, steps + more, {"enhancer": loss})

    network.train()
    flags = Flags.on(pictures.device)
    started = saved = time.perf_counter()
    while step < steps:
        batch = crops(pictures, *rehearsal.batch(config), np.random.default_rng([seed, step]))
        adam.zero_grad()
        loss, where = rehearsal.loss(network, batch, config), f"at step {step}: lower enhance.rate"
        if flags is not None:
            flags.look({f"the loss of {kind.name}": loss}, where)
        elif not torch.isfinite(loss):
            raise ValueError(f"the loss of {kind.name} must be finite, got {loss.item()} {where}")
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), rehearsal.clip)
        masked_step(adam, None if flags is None else flags.bad)
        step += 1
        if checkpoint is not None and (step == steps or time.perf_counter() - saved > SAVED):
            if flags is not None:
                flags.read()
            adam.zero_grad()
            state = {name: value.clone() for name, value in pack("enhancer", network, adam).items()}  # none shared
            saved = time.perf_counter()
            seconds = torch.tensor(earlier + saved - started, dtype=torch.float64)
            write_tensors(checkpoint, state | {"run": run, "step": torch.tensor(step), "seconds": seconds})
        tell(flags, step, steps, loss.detach(), partial(report, step))
    return network.eval().requires_grad_(False), earlier


def _identity(kind: Kind, config: Any, pictures: Tensor, seed: int) -> Tensor:
    """Hash of everything that a training depends on, uint8."""
    settings = json.dumps([kind.name, dataclasses.asdict(config), seed, digest(pictures)], default=str)
    run = hashlib.blake2b(settings.encode(), digest_size=16)
    return torch.from_numpy(np.frombuffer(run.digest(), np.uint8).copy())


def _restored(path: Path, network: nn.Module, adam: torch.optim.Adam, run: Tensor) -> tuple[int, float]:
    """Continue from a checkpoint; the steps that were done, and the seconds that they took."""
    tensors = read(path)
    of, step = tensors.get("run"), tensors.get("step")
    if of is None or of.dtype != run.dtype or not torch.equal(of, run):
        raise ValueError(f"{path} belongs to a run of other pictures or settings: delete it or restore them")
    seconds = float(tensors.get("seconds", torch.tensor(torch.nan)))
    counted = step is not None and step.shape == () and step.dtype == torch.int64 and int(step) >= 0
    if step is None or not counted or not 0 <= seconds < math.inf:
        raise ValueError(f"{path} is damaged: delete it, the run then starts over")
    unpack("enhancer", tensors, network, adam)
    return int(step), seconds
