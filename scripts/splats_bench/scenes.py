"""Scenes that the measurements of the splat engine share, and their stopwatch."""

import math
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor


def common_scene(n: int, size: int = 256) -> dict[str, Tensor]:
    """Means uniform in [-1, 1]^3, scales uniform in [0, 1], random rotations, a camera at z = 8, 90 degrees wide."""
    g = torch.Generator().manual_seed(0)
    u, v, w = torch.rand(3, n, generator=g)
    two_pi = 2 * math.pi
    a, b = torch.sqrt(1 - u), torch.sqrt(u)
    quats = [a * torch.sin(two_pi * v), a * torch.cos(two_pi * v), b * torch.sin(two_pi * w), b * torch.cos(two_pi * w)]
    view = torch.eye(4)
    view[2, 3] = 8.0
    focal = 0.5 * size / math.tan(math.pi / 4)
    return {
        "means": 2 * torch.rand(n, 3, generator=g) - 1,
        "quats": torch.stack(quats, -1),
        "scales": torch.rand(n, 3, generator=g),
        "opacities": torch.ones(n),  # before the sigmoid
        "colors": torch.rand(n, 3, generator=g),  # before the sigmoid
        "viewmats": view[None],
        "Ks": torch.tensor([[[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]]]),
    }


def best(call: Callable[[], Any], repeat: int, seconds: float = 20.0) -> float:
    """Smallest wall time of up to `repeat` calls, in seconds; after three of them, only until `seconds` are used up."""
    times: list[float] = []
    started = time.perf_counter()
    while len(times) < min(3, repeat) or (len(times) < repeat and time.perf_counter() - started < seconds):
        before = time.perf_counter()
        call()
        times.append(time.perf_counter() - before)
    return min(times)
