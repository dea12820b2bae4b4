"""The training loop: one step, the rate over the steps, checkpoints, and a look at pairs that are not trained on."""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from safetensors import safe_open
from torch import Tensor, nn

from denoising.pairs import Pairs, photograph, random_camera
from denoising.pictures import picture
from novags.methods.denoised.anscombe import Anscombe
from novags.methods.denoised.network import Network
from novags.splats.files.tensors import read, write_tensors
from novags.splats.training.companion import pack, unpack

WARM_UP = 100  # steps
DECAY = 0.3  # of all steps, at the end
LARGEST_GRADIENT = 1.0
CHECKED = 1_000_000_000  # numbers from here on are pictures that training never draws
CHECKED_LEVELS = (5.0, 20.0, 80.0)


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """How long and how fast.

    The rate rises, stays, and falls to zero in a straight line: until the fall begins, a run is the same however long
    it is to be, and one that was stopped there can be finished in fewer steps.
    """

    steps: int
    rate: float

    def at(self, step: int) -> float:
        """The learning rate of a step."""
        rising = (step + 1) / WARM_UP
        falling = (self.steps - step) / max(1.0, DECAY * self.steps)
        return self.rate * min(1.0, rising, falling)


def loss_of(network: Network, pairs: Pairs, kind: str) -> Tensor:
    """Distance of the estimate from the noise-free picture, in units of the noise."""
    stabilised = Anscombe(pairs.read_variance[..., None, None])
    found = network(stabilised(pairs.electrons), pairs.mask, pairs.read_variance)
    wanted = stabilised(pairs.clean)
    return F.l1_loss(found, wanted) if kind == "l1" else F.mse_loss(found, wanted)


class Training:
    """A network and its optimiser."""

    def __init__(
        self, network: nn.Module, schedule: Schedule, loss: Callable[[Any, Any], Tensor], settings: dict[str, Any]
    ) -> None:
        """settings: What a step follows from beside the schedule, by option; values that JSON holds."""
        self.settings = settings
        self.network, self.schedule, self.loss, self.step = network, schedule, loss, 0
        self.optimizer = torch.optim.Adam(network.parameters(), lr=schedule.rate, betas=(0.9, 0.99))

    def advance(self, pairs: Any) -> float:
        """One step; returns the loss."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.schedule.at(self.step)
        loss = self.loss(self.network, pairs)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), LARGEST_GRADIENT)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        self.step += 1
        value = loss.item()
        if not math.isfinite(value):
            raise ValueError(f"the loss must be finite, got {value} at step {self.step}: lower --rate")
        return value

    def save(self, path: Path, seconds: float) -> None:
        """Everything that the next step depends on."""
        more = {"steps": torch.tensor(self.step), "seconds": torch.tensor(seconds, dtype=torch.float64)}
        settings = json.dumps(self.settings | asdict(self.schedule))
        write_tensors(path, pack("network", self.network, self.optimizer) | more, {"settings": settings})

    def restore(self, path: Path) -> float:
        """Continue from `save`; returns the seconds that were spent before.

        Raises:
            ValueError: If the file is damaged, or a training with these settings would not have made it.
        """
        tensors = read(path)
        self._require_same(path, int(tensors["steps"]))
        unpack("network", tensors, self.network, self.optimizer)
        self.step = int(tensors["steps"])
        return float(tensors["seconds"])

    def _require_same(self, path: Path, done: int) -> None:
        """Raise ValueError unless the finished steps belong to this training."""
        with safe_open(path, "pt") as file:
            then = json.loads((file.metadata() or {}).get("settings", "{}"))
        remedy = f"restore it, or delete {path} to start over"
        for name, value in self.settings.items():
            if (before := then.get(name, "not stated")) != value:
                raise ValueError(f"{name} must be as in the continued training, {before}, got {value}: {remedy}")
        planned = Schedule(steps=then["steps"], rate=then["rate"])
        if any(planned.at(step) != self.schedule.at(step) for step in range(done)):
            raise ValueError(
                f"the rate of the {done} steps that are done must be this training's; they had --steps "
                f"{planned.steps} --rate {planned.rate:g}, got --steps {self.schedule.steps} --rate "
                f"{self.schedule.rate:g}: {remedy}"
            )


def checks(count: int, size: int) -> list[Pairs]:
    """Pairs that are not trained on: synthetic pictures at every level, half of them behind a colour filter array."""
    rng = np.random.default_rng(1)
    found = []
    for i in range(count):
        clean = picture(CHECKED + i, size)
        for level in CHECKED_LEVELS:
            found.append(photograph(clean, random_camera(rng, bayer=i % 2 == 1), level, seed=i))
    return found


def checked(network: Network, pairs: list[Pairs]) -> tuple[float, float]:
    """Mean squared error in units of the noise, of three chips and of mosaics."""
    with torch.no_grad():
        errors = [float(loss_of(network, one, "l2")) for one in pairs]
    mosaic = [bool((one.mask == 0).any()) for one in pairs]
    means = [float(np.mean([e for e, m in zip(errors, mosaic, strict=True) if m == want])) for want in (False, True)]
    return means[0], means[1]
