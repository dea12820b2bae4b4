"""Which Gaussians are the first ones that a ray meets, and which the last ones."""

# mypy: allow-untyped-defs

from typing import Any

import numpy as np
import torch
from torch import Tensor

from novags.splats.cpu.compiler import kernel
from novags.splats.cpu.raster.record import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from novags.splats.training.step import Info

Arrays = tuple[np.ndarray[Any, Any], ...]


def first_and_last(info: Info, width: int, height: int, count: int) -> tuple[Tensor, Tensor]:
    """Gaussians among the first, and among the last, `count` of the rays of a view, that are composited there.

    Args:
        info: Of `rasterize`, not packed, of one view.
        width: Of the picture, px.
        height: Of the picture, px.
        count: M of LE3D, at least 1.

    Returns:
        Both bool [N], on the device of the Gaussians.
    """
    order = torch.argsort(info["depths"][0].detach(), stable=True)
    named = (info[name][0].detach().cpu().contiguous().numpy() for name in ("means2d", "radii", "conics", "opacities"))
    first, last = np.zeros(len(order), np.bool_), np.zeros(len(order), np.bool_)
    mark(order.cpu().numpy(), *named, width, height, count, first, last)
    device = order.device
    return torch.from_numpy(first).to(device), torch.from_numpy(last).to(device)


@kernel
def mark(order, means2d, radii, conics, opacities, width, height, count, first, last):
    """Composite Gaussians front to back as the rasteriser does, and mark the ends of each pixel's list."""
    left = np.ones((height, width), np.float32)  # transmittance; negative once a pixel has stopped
    met = np.zeros((height, width), np.int64)
    newest = np.full((height, width, count), -1, np.int64)  # the last ones met, in a ring
    for i in order:
        reach_x, reach_y = radii[i, 0], radii[i, 1]
        if reach_x <= 0 or reach_y <= 0:
            continue
        x, y = means2d[i, 0], means2d[i, 1]
        a, b, c = conics[i, 0], conics[i, 1], conics[i, 2]
        low_x, high_x = max(0.0, np.floor(x - reach_x)), min(float(width), np.ceil(x + reach_x))
        low_y, high_y = max(0.0, np.floor(y - reach_y)), min(float(height), np.ceil(y + reach_y))
        for v in range(int(low_y), int(high_y)):
            for u in range(int(low_x), int(high_x)):
                if left[v, u] < 0:
                    continue
                dx, dy = np.float32(u + 0.5) - x, np.float32(v + 0.5) - y
                power = np.float32(0.5) * (a * dx * dx + c * dy * dy) + b * dx * dy
                alpha = min(opacities[i] * np.exp(-power), ALPHA_MAX)
                if alpha < ALPHA_MIN:
                    continue
                after = left[v, u] * (1 - alpha)
                if after < TRANSMITTANCE_MIN:
                    left[v, u] = -1
                    continue
                left[v, u] = after
                if met[v, u] < count:
                    first[i] = True
                newest[v, u, met[v, u] % count] = i
                met[v, u] += 1
    for v in range(height):
        for u in range(width):
            for k in range(count):
                if newest[v, u, k] >= 0:
                    last[newest[v, u, k]] = True
