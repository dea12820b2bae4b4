"""The guided filter written out, with loops over pixels."""

from collections.abc import Callable

import numpy as np
import pytest


def window(values: np.ndarray, y: int, x: int, radius: int) -> np.ndarray:
    return values[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]


def smooth(plane: np.ndarray, radius: int, epsilon: float) -> np.ndarray:
    a, b, out = np.empty_like(plane), np.empty_like(plane), np.empty_like(plane)
    for y, x in np.ndindex(plane.shape):
        near = window(plane, y, x, radius)
        a[y, x] = near.var() / (near.var() + epsilon)
        b[y, x] = near.mean() * (1 - a[y, x])
    for y, x in np.ndindex(plane.shape):
        out[y, x] = window(a, y, x, radius).mean() * plane[y, x] + window(b, y, x, radius).mean()
    return out


@pytest.fixture(name="window")
def window_by_hand() -> Callable[[np.ndarray, int, int, int], np.ndarray]:
    """What lies within a radius of a pixel."""
    return window


@pytest.fixture
def smooth_by_hand() -> Callable[[np.ndarray, int, float], np.ndarray]:
    """A plane, radius and epsilon to the plane guided by itself."""
    return smooth
