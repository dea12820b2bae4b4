"""What is checked on a GPU without waiting for it: flags that stay there, and are read together now and then.

On a CPU a number that is not finite stops the iteration that it occurs in. To ask a GPU for each of them would let it
run dry again and again. There the answer is a flag in its own memory: each update is masked by it on the spot, so that
a damaged state never replaces the last good one, and the host hears of it up to `EVERY` iterations later, with the name
of the first quantity that was wrong, and when.
"""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from .guard import NotFinite

EVERY = 20  # iterations between two readings
PARAMETER = "parameter "  # begins the names of what an update has damaged already, where nothing leads back
MOST = 1 << 10  # quantities that are looked at together

Delivered = Callable[[list[float]], None]


class Flags:
    """Whether all numbers of a run have been finite so far, and which was the first that was not.

    Attributes:
        good: 0-d bool tensor on the GPU: updates that are not to happen after a fault are masked by it.
        iteration: The present one; `read` sets it to the faulty one.
    """

    def __init__(self, device: torch.device) -> None:
        self.good = torch.ones((), dtype=torch.bool, device=device)
        self.iteration = 0
        self._fault = torch.zeros((), device=device)  # 1 + which look * MOST + which quantity
        self._looks: list[tuple[list[str], str, int]] = []
        self._kept: list[tuple[int, Tensor, Delivered]] = []

    @staticmethod
    def on(device: torch.device) -> "Flags | None":
        """None on a CPU, whose numbers are known at once."""
        return None if device.type == "cpu" else Flags(device)

    @property
    def bad(self) -> Tensor:
        """1.0 after a fault, else 0.0: the `found_inf` of torch's fused optimisers, which then change nothing."""
        return (~self.good).float()

    def look(self, tensors: Mapping[str, Tensor], where: str) -> None:
        """Note the first of some tensors, by name, that is not finite; `where` is the rest of its message."""
        sizes = torch.stack([torch.linalg.vector_norm(t.detach(), torch.inf) for t in tensors.values()])
        wrong = ~torch.isfinite(sizes)
        code = 1 + len(self._looks) * MOST + wrong.to(torch.uint8).argmax()
        damaged = wrong.any()
        self._fault = torch.where(self.good & damaged, code.float(), self._fault)
        self.good = self.good & ~damaged
        self._looks.append((list(tensors), where, self.iteration))

    def keep(self, numbers: Tensor, deliver: Delivered) -> None:
        """Read these numbers [n] at the next reading, and hand them over if nothing was wrong before they were kept."""
        self._kept.append((len(self._looks), numbers.detach(), deliver))

    def read(self) -> None:
        """Wait for the GPU, once.

        Raises:
            NotFinite: With the first quantity that was not finite.
        """
        looks, kept = self._looks, self._kept
        self._looks, self._kept = [], []
        fault, *numbers = torch.cat([self._fault[None], *(tensor for _, tensor, _ in kept)]).tolist()
        number, quantity = divmod(int(fault) - 1, MOST) if fault else (len(looks), 0)
        for since, tensor, deliver in kept:
            if since <= number:
                deliver(numbers[: len(tensor)])
            numbers = numbers[len(tensor) :]
        if fault:
            names, where, self.iteration = looks[number]
            name = names[quantity]
            raise NotFinite(f"{name} must be finite, and is not {where}", resumable=not name.startswith(PARAMETER))


def tell(flags: Flags | None, step: int, steps: int, loss: float | Tensor, report: Callable[[float], None]) -> None:
    """Report the loss of a network's step, the last one of all `steps` too.

    At once on a CPU; on a GPU with the next reading, for which it is time now and then.

    Raises:
        NotFinite: As `Flags.read` says.
    """
    if flags is None:
        report(float(loss))
        return
    flags.keep(torch.as_tensor(loss)[None], lambda numbers: report(numbers[0]))
    if step % EVERY == 0 or step == steps:
        flags.read()
