"""What a render costs: seconds per stage, predicted seconds, peak memory, versions behind the numbers."""

from __future__ import annotations

import importlib.metadata
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from simscenes.render.passes import Passes, pass_spp
from simscenes.render.radiance import Method, View
from simscenes.render.sensors import PILOT_SPP
from simscenes.rigs import Rig


class Stopwatch:
    """Seconds per named stage: of this call, and of earlier ones that were interrupted."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.earlier: dict[str, float] = {}

    def with_earlier(self) -> dict[str, float]:
        """The total cost of the job."""
        names = dict.fromkeys((*self.earlier, *self.seconds))
        return {name: self.earlier.get(name, 0.0) + self.seconds.get(name, 0.0) for name in names}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to one stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def predict_seconds(
    method: Method, rig: Rig, views: dict[int, View], spp: int | None, target_error: float | None
) -> float:
    """Predict the seconds that rendering these views will take, at a cost of about 6 % of them.

    A pass is timed on its second run, when its kernel is already compiled. With `target_error` the pass spreads samples
    unevenly, and the samples needed are predicted from pilots of up to three of `views`, which keep them for
    their render.
    """
    numbers = sorted(views)
    first = View(method, rig, numbers[0])  # a view of its own: those in `views` must not depend on the prediction
    if target_error is None:
        size = pass_spp(min((spp or 256) * len(views) / 32, 64))
        return _seconds_per_sample(first, size, even=True) * (spp or 2) * len(views)
    chosen = sorted({numbers[0], numbers[len(views) // 2], numbers[-1]})
    needed = [views[i].predict_spp(target_error) + 2 * PILOT_SPP for i in chosen]
    return _seconds_per_sample(first, PILOT_SPP, even=first.even) * sum(needed) / len(needed) * len(views)


def _seconds_per_sample(view: View, size: int, *, even: bool) -> float:
    """Seconds that one sample in every pixel takes, in a pass of `size`."""
    image = (view.rig.height, view.rig.width)
    for _ in range(2):
        passes, start = Passes(image), time.perf_counter()
        if even:
            view.run(passes, 1, size)
        else:
            view.run_uneven(passes, 1, np.ones(image, np.int64), size)
    return (time.perf_counter() - start) / size


def peak_bytes() -> int:
    """Largest resident memory of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else 1024 * peak)


def versions() -> dict[str, str]:
    """Versions of what the pixels depend on."""
    return {p: importlib.metadata.version(p) for p in ("mitsuba", "drjit", "numpy")} | {
        "python": sys.version.split()[0]
    }
