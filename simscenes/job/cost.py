"""The cost of a render: seconds per stage, predicted seconds, peak memory, versions behind the numbers."""

from __future__ import annotations

import importlib.metadata
import math
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from simscenes.render.radiance import FIRST, MAX_SPP, FirstSamples, RenderedView, RenderMethod
from simscenes.rigs import Rig

PART = 1 / 64  # of the samples of a job, twice, to predict the time of the others


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
    method: RenderMethod, rig: Rig, views: dict[int, RenderedView], spp: int | None, target_error: float | None,
    worth: float | None = None,
) -> float:  # fmt: skip
    """Predict the seconds that rendering these views will take.

    `worth`: how many views of `spp` samples, or of `target_error`, they cost together; None: as many as there are.

    With `target_error` from pilots of up to three of `views`, which keep them as their first samples: that costs
    nothing. Else from some pixels of the first view, at about 3 % of the job: they are timed on their second run, when
    the kernel, which the job shares, is compiled.

    Raises:
        ValueError: If one of these pilots says that the target takes more samples than a view may have.
    """
    numbers, worth = sorted(views), len(views) if worth is None else worth
    if target_error is not None:
        chosen = sorted({numbers[0], numbers[len(views) // 2], numbers[-1]})
        _check_reach({i: views[i].pilot for i in chosen}, target_error)
        each = [views[i].pilot.seconds * views[i].predict_spp(target_error) for i in chosen]
        return sum(each) / len(each) * worth
    first = RenderedView(method, rig, numbers[0])  # a view of its own: `views` must not depend on the prediction
    return first.seconds(spp or 2, PART * worth) * worth


def _check_reach(pilots: dict[int, FirstSamples], target: float) -> None:
    worst = max(pilots, key=lambda i: pilots[i].error)
    needed = FIRST * (pilots[worst].error / target) ** 2
    if needed > MAX_SPP:
        nearest = math.ceil(100 * pilots[worst].error * math.sqrt(FIRST / MAX_SPP)) / 100
        raise ValueError(
            f"a relative error of {target:.3g} is out of reach: view {worst} would take about {needed:,.0f} samples "
            f"per pixel, {needed * pilots[worst].seconds:,.0f} s, and may have {MAX_SPP:,}; few paths carry much of "
            "its light (small lamps seen in glass, in metal or through fog). "
            f"Ask for {nearest:g} or more, or for a number of samples"
        )


def peak_bytes() -> int:
    """Largest resident memory of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else 1024 * peak)


def versions() -> dict[str, str]:
    """Versions of the packages that the pixels depend on."""
    return {p: importlib.metadata.version(p) for p in ("mitsuba", "drjit", "numpy")} | {
        "python": sys.version.split()[0]
    }
