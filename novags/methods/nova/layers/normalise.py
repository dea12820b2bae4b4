"""Instance normalisation and the rectifier after it, in one, on a CPU.

torch's own turns maps whose channels lie beside each other into another layout and back, and its batch normalisation,
which does not, sums so many pixels in float32 that maps of a small deviation lose half of their digits. Here sums are
float64 over runs of RUN pixels in float32, and squares are taken from the mean.
"""

# mypy: allow-untyped-defs

from typing import Any

import numpy as np
import torch
from torch import Tensor

from novags.splats.cpu.compiler import kernel
from novags.splats.cpu.parallel import run

RUN = 64
GRAIN = 16  # channels of a cache line
EPS = 1e-5  # torch's own for this layer; without it a map that hardly varies would be rounding noise
CONSTANT = 1e-6  # some float32 roundings of a sum of order one, such as a convolution's
ZERO, ONE, HIGHEST = np.float32(0), np.float32(1), np.float32(np.inf)


def normalised(x: Tensor, slope: float) -> Tensor:
    """Maps of mean 0 and deviation 1, those that are constant up to rounding 0; below zero times a slope.

    Args:
        x: [B, D, H, W] float32, on a CPU.
        slope: Of the rectifier; 1 for none.
    """
    return _Normalised.apply(x, slope)


class _Normalised(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, slope: float) -> Tensor:
        x = x.contiguous(memory_format=torch.channels_last)
        y = torch.empty_like(x)
        mean, scale = (np.empty((len(x), x.shape[1]), np.float32) for _ in range(2))
        run(forward, x.shape[1], GRAIN, _pixels(x), np.float32(slope), _pixels(y), mean, scale)
        ctx.save_for_backward(x)
        ctx.rest = np.float32(slope), mean, scale
        return y

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        (x,) = ctx.saved_tensors
        gradient = gradient.contiguous(memory_format=torch.channels_last)
        found = torch.empty_like(x)
        run(backward, x.shape[1], GRAIN, _pixels(x), _pixels(gradient), *ctx.rest, _pixels(found))
        return found, None


def _pixels(x: Tensor) -> np.ndarray:
    """The memory of maps [B, D, H, W], channels last, as [B, H W, D]."""
    return x.detach().permute(0, 2, 3, 1).flatten(1, 2).numpy()


@kernel
def forward(begin, end, x, slope, y, mean, scale):
    """Fill y [B, P, D], mean [B, D] and scale [B, D] = 1 / deviation, 0 of a constant map, in channels begin..end-1."""
    images, pixels = x.shape[:2]
    size = end - begin
    part, low, high = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    total = np.empty(size, np.float64)
    for b in range(images):
        middle, factor = mean[b, begin:end], scale[b, begin:end]
        total[:], low[:], high[:] = 0, HIGHEST, -HIGHEST
        for start in range(0, pixels, RUN):
            part[:] = 0
            for p in range(start, min(start + RUN, pixels)):
                row = x[b, p, begin:end]
                for c in range(size):
                    value = row[c]
                    part[c] += value
                    low[c] = value if value < low[c] else low[c]
                    high[c] = value if value > high[c] else high[c]
            for c in range(size):
                total[c] += part[c]
        for c in range(size):
            middle[c] = total[c] / pixels
        total[:] = 0
        for start in range(0, pixels, RUN):
            part[:] = 0
            for p in range(start, min(start + RUN, pixels)):
                row = x[b, p, begin:end]
                for c in range(size):
                    part[c] += (row[c] - middle[c]) ** 2
            for c in range(size):
                total[c] += part[c]
        for c in range(size):
            constant = high[c] - low[c] <= CONSTANT * (1 + abs(high[c]))
            factor[c] = 0 if constant else 1 / np.sqrt(total[c] / pixels + EPS)
        for p in range(pixels):
            row, out = x[b, p, begin:end], y[b, p, begin:end]
            for c in range(size):
                value = (row[c] - middle[c]) * factor[c]
                out[c] = value if value > ZERO else slope * value


@kernel
def backward(begin, end, x, gradient, slope, mean, scale, found):
    """The gradient in x from the one in y, both [B, P, D], in channels begin..end-1."""
    images, pixels = x.shape[:2]
    size = end - begin
    part, along = np.empty(size, np.float32), np.empty(size, np.float32)
    total, projected = np.empty(size, np.float64), np.empty(size, np.float64)
    for b in range(images):
        middle, factor = mean[b, begin:end], scale[b, begin:end]
        total[:], projected[:] = 0, 0
        for start in range(0, pixels, RUN):
            part[:], along[:] = 0, 0
            for p in range(start, min(start + RUN, pixels)):
                row, slopes = x[b, p, begin:end], gradient[b, p, begin:end]
                for c in range(size):
                    value = (row[c] - middle[c]) * factor[c]
                    g = slopes[c] * (ONE if value > ZERO else slope)
                    part[c] += g
                    along[c] += g * value
            for c in range(size):
                total[c] += part[c]
                projected[c] += along[c]
        for c in range(size):
            part[c], along[c] = total[c] / pixels, projected[c] / pixels
        for p in range(pixels):
            row, slopes, out = x[b, p, begin:end], gradient[b, p, begin:end], found[b, p, begin:end]
            for c in range(size):
                value = (row[c] - middle[c]) * factor[c]
                g = slopes[c] * (ONE if value > ZERO else slope)
                out[c] = factor[c] * (g - part[c] - value * along[c])
