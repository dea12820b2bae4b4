"""One exposure for a whole set, from the few brightest pixels of its views."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

BELOW_WHITE = 0.97  # of all pixels, so that a lamp in view does not darken the room


class RunningQuantile:
    """`np.quantile` of values that come in parts, bit for bit; only values at or above it are kept.

    Args:
        q: The quantile, 0..1.
        count: Total number of values.
    """

    def __init__(self, q: float, count: int) -> None:
        self._left, place = count, q * (count - 1)  # the place among the sorted values, between two of them
        self._between, self._room = place - math.floor(place), count - math.floor(place)
        self._kept: NDArray[Any] | None = None

    def add(self, values: NDArray[Any]) -> None:
        """Take in the next values, of any shape."""
        joined = values.ravel() if self._kept is None else np.concatenate([self._kept, values.ravel()])
        if len(joined) > self._room:
            joined = np.partition(joined, len(joined) - self._room)[-self._room :].copy()  # a view would keep the rest
        self._kept, self._left = joined, self._left - values.size

    def value(self) -> float:
        """The quantile, once all values are in."""
        assert self._kept is not None, "no values were added"
        assert self._left == 0, f"{self._left} values are missing"
        neighbours = np.partition(self._kept, min(1, len(self._kept) - 1))[:2]
        return float(np.quantile(neighbours, self._between))  # numpy's own rounding


def exposure_scale(white: float) -> float:
    """The factor on linear values, if `white` is the level that becomes 1; 1 for a black set."""
    return 1.0 / white if white > 0 else 1.0
