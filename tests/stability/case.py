"""A hard case: what is computed, where, the error it may have, and how far a result is from its reference."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
import torch

from novags.testbed.console.provenance import package_version
from simscenes.backend import backend_status

EPS = float(np.finfo(np.float32).eps)
LARGEST = "of the largest value"  # the unit of `relative_error`
THREADS = (1, 2)
THREADED = ("torch", "numba", "gsplat")  # numpy has one thread, Mitsuba its own pool


@dataclass(frozen=True)
class Setting:
    """Where a case is computed: one of its backends, on so many threads."""

    backend: str
    threads: int = 1

    def __str__(self) -> str:
        return f"{self.backend}, {self.threads} thread{'s' if self.threads > 1 else ''}"


@dataclass(frozen=True, kw_only=True)
class Case:
    """One named hard case.

    `measure` computes it in the setting given and returns the worst error of values and gradients against a reference
    of more digits: at least 0, or NaN or infinity where the result is not finite. `unit` says what the error is
    relative to. A case that has to be refused returns `refusal(...)`, whose unit is "refused" and whose bound is 0.
    """

    part: str
    name: str
    bound: float
    unit: str
    measure: Callable[[Setting], float]
    backends: tuple[str, ...]
    slow: bool

    def settings(self) -> list[Setting]:
        """Every setting that this machine offers for the case."""
        here = [backend for backend in self.backends if available(backend)]
        return [Setting(backend, n) for backend in here for n in (THREADS if backend in THREADED else (1,))]

    def error(self, setting: Setting) -> float:
        """The error in a setting."""
        with _threads(setting.threads):
            return float(self.measure(setting))


Error = Callable[[Case, Setting], float]  # the fixtures of these names
Fails = Callable[..., bool]


@dataclass
class Part:
    """The cases of one part of the project, in the order in which they were added."""

    name: str
    cases: list[Case] = field(default_factory=list)

    def case(
        self, name: str, *, bound: float, unit: str, backends: Sequence[str] = ("torch",), slow: bool = False
    ) -> Callable[[Callable[[Setting], float]], Callable[[Setting], float]]:
        """Add the decorated function as the case `name`.

        Args:
            name: What is hard, in a few words.
            bound: Largest error that holds.
            unit: What the error is relative to.
            backends: "torch", "numba", "gsplat" (on a GPU), "numpy", or a Mitsuba variant.
            slow: Takes longer than some seconds: left out of the default run.
        """

        def add(measure: Callable[[Setting], float]) -> Callable[[Setting], float]:
            assert name not in {case.name for case in self.cases}, f"{self.name} has two cases named {name}"
            self.cases.append(
                Case(
                    part=self.name, name=name, bound=bound, unit=unit, measure=measure, backends=tuple(backends),
                    slow=slow,
                )
            )  # fmt: skip
            return measure

        return add

    def named(self, start: str) -> Case:
        """The case of that name, or the only one whose name starts so."""
        (found,) = [case for case in self.cases if case.name == start] or [
            case for case in self.cases if case.name.startswith(start)
        ]
        return found


def available(backend: str) -> bool:
    """Whether this machine has a backend."""
    if backend == "gsplat":
        return torch.cuda.is_available() and package_version("gsplat") is not None
    if "_" in backend:  # a Mitsuba variant
        return backend_status(backend.rpartition("_")[0])[0]  # without its colours
    return True


def refusal(work: Callable[[], object], *words: str) -> float:
    """0 if `work` raises a ValueError of one line that holds every one of `words`; infinity if it does not."""
    try:
        work()
    except ValueError as problem:
        text = str(problem)
        return 0.0 if text and "\n" not in text and all(word in text for word in words) else math.inf
    return math.inf


def worse(*errors: float) -> float:
    """The largest of some errors; NaN if one is NaN, which `max` loses."""
    return math.nan if any(map(math.isnan, errors)) else float(max(errors))


def relative_error(found: Any, wanted: Any) -> float:
    """The largest difference over the largest value of the reference; infinite where a number found is not finite.

    Args:
        found: Array or tensor of any float dtype.
        wanted: The reference, of the same shape. All zero: the difference itself is returned.

    Raises:
        ValueError: If the shapes differ, or the reference is not finite.
    """
    found, wanted = _array(found), _array(wanted)
    if found.shape != wanted.shape or not np.isfinite(wanted).all():
        raise ValueError(f"the reference must be finite and of shape {found.shape}, got {wanted.shape}")
    if not np.isfinite(found).all():
        return math.inf
    largest = float(np.abs(wanted).max(initial=0.0)) or 1.0
    return float(np.abs(found - wanted).max(initial=0.0)) / largest


def worst_error(pairs: Iterable[tuple[Any, Any]]) -> float:
    """The largest `relative_error` of pairs (found, wanted), each relative to its own largest value."""
    return max(relative_error(found, wanted) for found, wanted in pairs)


def _array(values: Any) -> np.ndarray:
    if isinstance(values, torch.Tensor):
        values = values.detach().cpu().double().numpy()
    return np.asarray(values, dtype=np.float64)


@contextmanager
def _threads(n: int) -> Iterator[None]:
    before = torch.get_num_threads(), numba.get_num_threads()
    torch.set_num_threads(n)
    numba.set_num_threads(min(n, numba.config.NUMBA_NUM_THREADS))
    try:
        yield
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])
