"""Instance normalisation and the rectifier after it, in one, on a CPU.

torch's own turns maps whose channels lie beside each other into another layout and back, and its batch normalisation,
which does not, sums so many pixels in float32 that maps of a small deviation lose half of their digits. Here sums are
float64 over runs of RUN pixels in float32, and squares are taken from the mean. Maps in bfloat16 are read and written
as such, and computed with in float32.
"""

# mypy: allow-untyped-defs

from typing import Any

import numpy as np
import torch
from torch import Tensor

from novags.splats.cpu.compiler import inline, kernel
from novags.splats.cpu.parallel import run

RUN = 64
GRAIN = 16  # channels of a cache line
EPS = 1e-5  # torch's own for this layer; without it a map that hardly varies would be rounding noise
CONSTANT = 1e-6  # some float32 roundings of a sum of order one, such as a convolution's
ZERO, ONE, HIGHEST = np.float32(0), np.float32(1), np.float32(np.inf)


def normalised(x: Tensor, slope: float) -> Tensor:
    """Maps of mean 0 and deviation 1, those that are constant up to rounding 0; below zero times a slope.

    Args:
        x: [B, D, H, W] float32 or bfloat16, on a CPU.
        slope: Of the rectifier; 1 for none.
    """
    return _Normalised.apply(x, slope)


class _Normalised(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, slope: float) -> Tensor:
        x = x.contiguous(memory_format=torch.channels_last)
        y = torch.empty_like(x)
        mean, scale = (np.empty((len(x), x.shape[1]), np.float32) for _ in range(2))
        work = forward if x.dtype == torch.float32 else forward_bfloat16
        run(work, x.shape[1], GRAIN, _pixels(x), np.float32(slope), _pixels(y), mean, scale)
        ctx.save_for_backward(x)
        ctx.rest = np.float32(slope), mean, scale
        return y

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        (x,) = ctx.saved_tensors
        gradient = gradient.contiguous(memory_format=torch.channels_last)
        found = torch.empty_like(x)
        work = backward if x.dtype == torch.float32 else backward_bfloat16
        run(work, x.shape[1], GRAIN, _pixels(x), _pixels(gradient), *ctx.rest, _pixels(found))
        return found, None


def _pixels(x: Tensor) -> np.ndarray:
    """The memory of maps [B, D, H, W], channels last, as [B, H W, D]; bfloat16 as its bits."""
    pixels = x.detach().permute(0, 2, 3, 1).flatten(1, 2)
    return pixels.numpy() if x.dtype == torch.float32 else pixels.view(torch.uint16).numpy()


# A kernel is written once, with three functions: `read` gives a line of the memory, `place` says where a line of
# results is computed, and `write` brings it from there into the memory. For float32 the place is the memory itself.
# They stand in this file, by which its machine code is kept: a change elsewhere would go unnoticed.


@inline
def _itself(memory, line):
    """`read` and `place` of float32."""
    return memory


@inline
def _kept(line, memory):
    """`write` of float32."""


@inline
def _widened(memory, line):
    """`read` of bfloat16."""
    bits = line.view(np.uint32)
    for c in range(len(memory)):
        bits[c] = np.uint32(memory[c]) << np.uint32(16)
    return line


@inline
def _beside(memory, line):
    """`place` of bfloat16."""
    return line


@inline
def _rounded(line, memory):
    """`write` of bfloat16: the nearest, ties to even. A NaN of arithmetic, whose bits lie in this half, stays one."""
    bits = line.view(np.uint32)
    for c in range(len(memory)):
        odd = (bits[c] >> np.uint32(16)) & np.uint32(1)
        memory[c] = np.uint16((bits[c] + np.uint32(0x7FFF) + odd) >> np.uint32(16))


@inline
def _forward(begin, end, x, slope, y, mean, scale, read, place, write):
    images, places = x.shape[:2]
    size = end - begin
    part, low, high = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    line, result = np.empty(size, np.float32), np.empty(size, np.float32)
    total = np.empty(size, np.float64)
    for b in range(images):
        middle, factor = mean[b, begin:end], scale[b, begin:end]
        total[:], low[:], high[:] = 0, HIGHEST, -HIGHEST
        for start in range(0, places, RUN):
            part[:] = 0
            for p in range(start, min(start + RUN, places)):
                row = read(x[b, p, begin:end], line)
                for c in range(size):
                    value = row[c]
                    part[c] += value
                    low[c] = value if value < low[c] else low[c]
                    high[c] = value if value > high[c] else high[c]
            for c in range(size):
                total[c] += part[c]
        for c in range(size):
            middle[c] = total[c] / places
        total[:] = 0
        for start in range(0, places, RUN):
            part[:] = 0
            for p in range(start, min(start + RUN, places)):
                row = read(x[b, p, begin:end], line)
                for c in range(size):
                    part[c] += (row[c] - middle[c]) ** 2
            for c in range(size):
                total[c] += part[c]
        for c in range(size):
            constant = high[c] - low[c] <= CONSTANT * (1 + abs(high[c]))
            factor[c] = 0 if constant else 1 / np.sqrt(total[c] / places + EPS)
        for p in range(places):
            row, out = read(x[b, p, begin:end], line), place(y[b, p, begin:end], result)
            for c in range(size):
                value = (row[c] - middle[c]) * factor[c]
                out[c] = value if value > ZERO else slope * value
            write(out, y[b, p, begin:end])


@inline
def _backward(begin, end, x, gradient, slope, mean, scale, found, read, place, write):
    images, places = x.shape[:2]
    size = end - begin
    part, along = np.empty(size, np.float32), np.empty(size, np.float32)
    line, slope_line, result = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    total, projected = np.empty(size, np.float64), np.empty(size, np.float64)
    for b in range(images):
        middle, factor = mean[b, begin:end], scale[b, begin:end]
        total[:], projected[:] = 0, 0
        for start in range(0, places, RUN):
            part[:], along[:] = 0, 0
            for p in range(start, min(start + RUN, places)):
                row, slopes = read(x[b, p, begin:end], line), read(gradient[b, p, begin:end], slope_line)
                for c in range(size):
                    value = (row[c] - middle[c]) * factor[c]
                    g = slopes[c] * (ONE if value > ZERO else slope)
                    part[c] += g
                    along[c] += g * value
            for c in range(size):
                total[c] += part[c]
                projected[c] += along[c]
        for c in range(size):
            part[c], along[c] = total[c] / places, projected[c] / places
        for p in range(places):
            row, slopes = read(x[b, p, begin:end], line), read(gradient[b, p, begin:end], slope_line)
            out = place(found[b, p, begin:end], result)
            for c in range(size):
                value = (row[c] - middle[c]) * factor[c]
                g = slopes[c] * (ONE if value > ZERO else slope)
                out[c] = factor[c] * (g - part[c] - value * along[c])
            write(out, found[b, p, begin:end])


@kernel
def forward(begin, end, x, slope, y, mean, scale):
    """Fill y [B, P, D], mean [B, D] and scale [B, D] = 1 / deviation, 0 of a constant map, in channels begin..end-1."""
    _forward(begin, end, x, slope, y, mean, scale, _itself, _itself, _kept)


@kernel
def forward_bfloat16(begin, end, x, slope, y, mean, scale):
    """The same of bits of bfloat16."""
    _forward(begin, end, x, slope, y, mean, scale, _widened, _beside, _rounded)


@kernel
def backward(begin, end, x, gradient, slope, mean, scale, found):
    """The gradient in x from the one in y, both [B, P, D], in channels begin..end-1."""
    _backward(begin, end, x, gradient, slope, mean, scale, found, _itself, _itself, _kept)


@kernel
def backward_bfloat16(begin, end, x, gradient, slope, mean, scale, found):
    """The same of bits of bfloat16."""
    _backward(begin, end, x, gradient, slope, mean, scale, found, _widened, _beside, _rounded)
