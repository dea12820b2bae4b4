"""Recycled arrays: what one iteration frees, the next one takes, without new pages from the operating system."""

import math
from typing import Any

import numpy as np

LINE = 64  # bytes; one cache line, one AVX-512 register
SMALL = 1 << 14  # bytes below which malloc is as good
KEEP = 1 << 29  # bytes of free blocks kept at most

_free: dict[int, list[np.ndarray]] = {}
_kept = 0


class _Lease:
    """Owner of a block while any array looks into it; gives it back when the last one is gone."""

    def __init__(self, block: np.ndarray, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.block = block
        address = block.__array_interface__["data"][0]
        self.__array_interface__ = {
            "version": 3, "shape": shape, "typestr": dtype.str, "data": (address + -address % LINE, False),
        }  # fmt: skip

    def __del__(self) -> None:
        global _kept
        if _kept + len(self.block) <= KEEP:
            _kept += len(self.block)
            _free.setdefault(len(self.block), []).append(self.block)


def _size_class(n_bytes: int) -> int:
    """Rounded up by at most a quarter, so that a slowly growing scene finds its old blocks."""
    quarter = 1 << max(0, n_bytes.bit_length() - 3)
    return -(-n_bytes // quarter) * quarter


def empty(shape: tuple[int, ...] | int, dtype: Any = np.float32) -> np.ndarray:
    """Like `np.empty`, aligned to cache lines; the memory is recycled once no array refers to it."""
    global _kept
    dtype = np.dtype(dtype)
    shape = (shape,) if isinstance(shape, int) else shape
    n_bytes = math.prod(shape) * dtype.itemsize
    size = _size_class(max(n_bytes, 1)) + LINE
    blocks = _free.get(size)
    if blocks and n_bytes >= SMALL:
        block = blocks.pop()
        _kept -= size
    else:
        block = np.empty(size, np.uint8)
    return np.asarray(_Lease(block, shape, dtype))
