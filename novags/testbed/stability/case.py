"""A hard case: what is computed, where, and the error it may have."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numba
import torch

THREADS = (1, 2)
THREADED = ("torch", "numba", "gsplat")  # numpy has one thread, Mitsuba its own pool


@dataclass(frozen=True)
class Setting:
    """Where a case is computed: one of its backends, on so many threads."""

    backend: str
    threads: int

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


@dataclass(frozen=True)
class Measured:
    """The error of a case in a setting; `reason` is the exception that took its place, if one did."""

    case: Case
    setting: Setting
    error: float
    seconds: float
    reason: str | None = None

    @property
    def holds(self) -> bool:
        """Whether the error is a number within the bound."""
        return self.error <= self.case.bound

    def __str__(self) -> str:
        reason = f": {self.reason}" if self.reason else ""
        return (
            f"{self.case.part}, {self.case.name} ({self.setting}): error {self.error:.2g}, "
            f"bound {self.case.bound:.2g} {self.case.unit}{reason}"
        )


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
            slow: Takes longer than some seconds: left out unless asked for.
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


def available(backend: str) -> bool:
    """Whether this machine has a backend."""
    if backend == "gsplat":
        from novags.testbed.machine.provenance import package_version

        return torch.cuda.is_available() and package_version("gsplat") is not None
    if "_" in backend:  # a Mitsuba variant
        from simscenes.backend import backend_status

        return backend_status(backend.rpartition("_")[0])[0]  # without its colours
    return True


def measured(case: Case, setting: Setting) -> Measured:
    """Compute a case; an exception counts as an infinite error."""
    start = time.perf_counter()
    reason = None
    with _threads(setting.threads):
        try:
            error = float(case.measure(setting))
        except Exception as problem:  # whatever it is, the case does not hold
            error, reason = math.inf, f"{type(problem).__name__}: {problem}"
    return Measured(case, setting, error, time.perf_counter() - start, reason)


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
