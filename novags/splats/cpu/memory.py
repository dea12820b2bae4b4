"""Recycled arrays: the next iteration takes the memory that one frees, without new pages from the operating system."""

import ctypes
import math
import os
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

LINE = 64  # bytes; one cache line, one AVX-512 register
SMALL = 1 << 14  # bytes below which malloc is as good
KEEP = 2  # free bytes at most, in units of the bytes lately in use at once: views differ in size, so one unit is tight
FORGET = 1 / 4096  # part of that number that every array asked for takes away from it; about 50 make an iteration


class _Lease(np.ndarray):
    """A view of a whole block; gives it back when the last array that looks into it is gone.

    NumPy keeps the base of an array alive, and takes the first array for the base of a view of a view. It makes an
    exception for a view of another type whose memory does not belong to an array: hence this type, and ctypes blocks.
    """

    back: deque[Any] | None = None

    def __del__(self) -> None:
        if self.back is not None:
            self.back.append(self.base)  # nothing else: the garbage collector may be here in any thread, at any time


def _aligned(size: int) -> Any:
    """A new block of memory that begins at a cache line, as a ctypes array."""
    memory = np.empty(size + LINE, np.uint8)
    return (ctypes.c_uint8 * size).from_buffer(memory, -memory.__array_interface__["data"][0] % LINE)  # type: ignore[arg-type]


class Recycler:
    """Free blocks by size, the size used last at the end."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.free_bytes = 0
        self._free: dict[int, list[Any]] = {}
        self._back: deque[Any] = deque()
        self._in_use, self._lately = 0, 0.0  # bytes now; bytes at once, lately

    def empty(self, shape: tuple[int, ...] | int, dtype: Any = np.float32) -> np.ndarray:
        """Like `np.empty`, aligned to cache lines; the memory is recycled once no array refers to it."""
        dtype = np.dtype(dtype)
        shape = (shape,) if isinstance(shape, int) else shape
        n_bytes = max(math.prod(shape) * dtype.itemsize, 1)
        if n_bytes < SMALL:
            memory = np.empty(n_bytes + LINE, np.uint8)
            return np.ndarray(shape, dtype, memory, -memory.__array_interface__["data"][0] % LINE)
        size = _size_class(n_bytes)
        with self.lock:
            if self._back:
                self._collect()
            block = self._take(size)
        lease = _Lease(size, np.uint8, block)
        lease.back = self._back
        return np.ndarray(shape, dtype, lease)

    def _take(self, size: int) -> Any:
        blocks = self._free.pop(size, None)
        if blocks is None:
            block = _aligned(size)  # may fail, and must then not have been counted
        else:
            block = blocks.pop()
            self.free_bytes -= size
            if blocks:
                self._free[size] = blocks
        self._in_use += size
        self._lately = max(self._in_use, self._lately * (1 - FORGET))
        return block

    def _collect(self) -> None:
        """Shelve the blocks that came back, and free blocks of the sizes unused for longest."""
        while self._back:
            block = self._back.popleft()
            size = len(block)
            self._in_use -= size
            self.free_bytes += size
            blocks = self._free.pop(size, [])
            blocks.append(block)
            self._free[size] = blocks
        while self.free_bytes > KEEP * self._lately:
            size, blocks = next(iter(self._free.items()))
            blocks.pop()
            self.free_bytes -= size
            if not blocks:
                del self._free[size]

    def clear(self) -> None:
        """Free all blocks that nothing refers to."""
        with self.lock:
            self._collect()
            self._free.clear()
            self.free_bytes, self._lately = 0, float(self._in_use)


def _size_class(n_bytes: int) -> int:
    """Rounded up by at most a quarter, so that a slowly growing scene finds its old blocks."""
    quarter = 1 << max(0, n_bytes.bit_length() - 3)
    return -(-n_bytes // quarter) * quarter


_shared = Recycler()
empty, clear = _shared.empty, _shared.clear


def carve(
    *parts: tuple[tuple[int, ...] | int, Any], empty: Callable[..., np.ndarray] = empty
) -> tuple[np.ndarray, ...]:
    """Arrays of (shape, dtype) in one block that is recycled when none of them is in use any more.

    One block costs as much as one array: most of that is Python.
    """
    places, end = [], 0
    for shape, dtype in parts:
        places.append(end)
        n = math.prod(shape) if isinstance(shape, tuple) else shape
        end += -(-n * np.dtype(dtype).itemsize // LINE) * LINE
    block = empty(end, np.uint8)
    return tuple(np.ndarray(shape, dtype, block, at) for (shape, dtype), at in zip(parts, places, strict=True))


# a fork while another thread holds the lock would leave the child waiting for ever
os.register_at_fork(
    before=_shared.lock.acquire, after_in_parent=_shared.lock.release, after_in_child=_shared.lock.release
)
