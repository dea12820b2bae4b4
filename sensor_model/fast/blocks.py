"""Rows of a frame in blocks, on threads; pixels of a row in chunks, in the scratch array of `kernels.py`.

Importing this module imports numba.
"""
# numba infers types itself, and its decorators are untyped.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, untyped-decorator"

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from sensor_model.fast.kernels import CHUNK, SCRATCH, U, W, inline, jit, normal, uniform
from sensor_model.frame import streams

BLOCK = 1 << 16  # pixels per task: its charge, 0.5 MB, stays in the second-level cache
STEP = CHUNK - 2  # pixels per chunk: even, with room to shift when a crop starts at an odd column


def in_blocks(task: Callable[[int, int], int], shape: tuple[int, ...], threads: int | None) -> list[int]:
    """Run task(first row, end row) over all rows of a frame."""
    rows = max(1, BLOCK // (shape[1] * shape[2]))
    starts = range(0, shape[0], rows)
    ends = [min(y + rows, shape[0]) for y in starts]
    workers = min(threads or _cores(), len(ends))
    if workers == 1:
        return [task(*block) for block in zip(starts, ends, strict=True)]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(task, starts, ends))


def _cores() -> int:
    affinity = getattr(os, "sched_getaffinity", None)  # Linux only: the cores this process may use
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def address(draws: streams.Draws) -> tuple[np.uint64, ...]:
    """View, frame and the two halves of the seed, as the kernels take them."""
    return tuple(np.uint64(i) for i in (draws.view, draws.frame, *draws.key))


def scratch() -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.int64]]:
    """One task's `b` and `f`, see `kernels.py` and `kernels32.py`, and its list of places."""
    return np.empty(SCRATCH), np.empty(SCRATCH, np.float32), np.empty(CHUNK, np.int64)


def standard_normals(draws: streams.Draws, shape: tuple[int, ...], stream: int) -> NDArray[np.float64]:
    """One standard normal number per pixel of a frame of shape (h, w, c)."""
    draws.check_extent(shape)
    out = np.empty(np.prod(shape))
    where = (*draws.origin, *address(draws))
    in_blocks(lambda y0, y1: _normals(out, stream, shape, y0, y1, *where, *scratch()), shape, None)
    return out.reshape(shape)


@jit
def row_uniform(b, n, stream, channel, row, col, view, frame, k0, k1):
    """b[U:U + n] = the draws of columns col.. of one row, for any parity of col."""
    effect = np.uint64(stream * streams.CHANNELS + channel)
    odd = col % 2
    uniform(b, n + odd, row, col - odd, effect, view, frame, k0, k1)
    if odd:
        for i in range(n):
            b[U + i] = b[U + i + 1]


@inline
def load(b, to, flat, start, stride, n):
    """b[to:to + n] = every stride-th value of flat.

    The common stride 1 has a loop of its own, over a slice: there numba knows that no index is negative (it would
    have to wrap around), and LLVM that the values are contiguous.
    """
    if stride == 1:
        part = flat[start : start + n]
        for i in range(n):
            b[to + i] = part[i]
    else:
        for i in range(n):
            b[to + i] = flat[start + i * stride]


def _way_back(cast: type) -> Callable:
    """The inverse of `load`, by way of a type."""

    @inline
    def store(flat, start, stride, b, source, n):
        if stride == 1:
            part = flat[start : start + n]
            for i in range(n):
                part[i] = cast(b[source + i])
        else:
            for i in range(n):
                flat[start + i * stride] = cast(b[source + i])

    return store


store = _way_back(np.float64)
store_whole = _way_back(np.int32)  # whole numbers: SIMD cannot convert float64 straight to 8 or 16 bits


@jit
def _normals(out, stream, shape, y0, y1, row0, col0, view, frame, k0, k1, b, f, where):
    _, w, channels = shape
    for y in range(y0, y1):
        for c in range(channels):
            for x0 in range(0, w, STEP):
                n = min(STEP, w - x0)
                row_uniform(b, n, stream, c, row0 + y, col0 + x0, view, frame, k0, k1)
                normal(b, n, where)
                store(out, (y * w + x0) * channels + c, channels, b, W, n)
    return 0
