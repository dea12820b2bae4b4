"""Counter-based random numbers: every effect has one fixed draw per pixel.

Philox 4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011) maps a counter and a key to
128 random bits. Key: the seed. Counter: (row << 16 | column // 2, effect and channel, view, frame); of the bits, an
even column takes the first half and its odd neighbour the second. Only the names of effects from outside are hashed, so
two different draws of ours never share a counter; no draw depends on another one, on the thread count, or on the size
of the frame. Row blocks therefore need no alignment, and a crop, at any offset, equals the same crop of the whole; a
colour filter array begins at the crop's own first pixel. Effects that reach across pixels (crosstalk, point spread,
coupling, blooming) take the border of the crop for the sensor's.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sensor_model.params import require

# One stream per effect. DSNU to RTS_SITE belong to the camera, not to the frame; TIME and TEMPERATURE to the view.
SHOT, READ, ROW, COLUMN, BANDING, RTS, DSNU, PRNU, HOT, RTS_SITE, TIME, TEMPERATURE, DARK_FRAME, DARK_STEP = range(14)

FREE = 1 << 10  # streams from here on belong to effects from outside

ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
WEYL = (0x9E3779B9, 0xBB67AE85)
MASK = 0xFFFFFFFF
SIDE = 1 << 16  # rows and columns are numbered in 16 bits each
CHANNELS = 4  # room for the channel in the counter's second word

Words = tuple[NDArray[np.uint64], NDArray[np.uint64], NDArray[np.uint64], NDArray[np.uint64]]


def named(name: str) -> int:
    """The stream of this name. Two names share one with a probability of 1e-9."""
    number = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "big")
    return FREE + number % (2**32 // CHANNELS - FREE)


def philox(counter: Words, key: tuple[int, int]) -> Words:
    """128 random bits per counter: Philox 4x32-10, four 32-bit words held in uint64 arrays."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    mask, half = np.uint64(MASK), np.uint64(32)
    for _ in range(ROUNDS):
        p0, p1 = c0 * np.uint64(MULTIPLIERS[0]), c2 * np.uint64(MULTIPLIERS[1])
        c0, c1, c2, c3 = (p1 >> half) ^ c1 ^ np.uint64(k0), p1 & mask, (p0 >> half) ^ c3 ^ np.uint64(k1), p0 & mask
        k0, k1 = (k0 + WEYL[0]) & MASK, (k1 + WEYL[1]) & MASK
    return c0, c1, c2, c3


@dataclass(frozen=True, kw_only=True)
class Draws:
    """The random numbers of one frame, or (view = frame = 0, seed = serial) the fixed pattern of one camera."""

    seed: int  # 0..2**64-1
    view: int = 0  # 0..2**32-1
    frame: int = 0  # 0..2**32-1
    origin: tuple[int, int] = (0, 0)  # row and column of the first pixel on the sensor

    def __post_init__(self) -> None:
        """Refuse an index that would leave the bits the counter has for it."""
        require(0 <= self.seed < 2**64, "seed", "in [0, 2**64)", self.seed)
        require(0 <= self.view < 2**32, "view", "in [0, 2**32)", self.view)
        require(0 <= self.frame < 2**32, "frame", "in [0, 2**32)", self.frame)

    @property
    def key(self) -> tuple[int, int]:
        """The two halves of the seed."""
        return self.seed & MASK, self.seed >> 32

    def check_extent(self, shape: tuple[int, ...]) -> None:
        """Raise ValueError if a frame of this shape leaves the 16 bits of a row or column number."""
        end = (self.origin[0] + shape[0], self.origin[1] + shape[1])
        require(max(end) <= SIDE, "origin plus shape", f"within {SIDE} rows and columns", end)

    def uniforms(self, shape: tuple[int, ...], stream: int) -> NDArray[np.float64]:
        """One uniform number in (0, 1) per pixel of a frame of shape (h, w) or (h, w, channels)."""
        self.check_extent(shape)
        index = np.indices(shape, sparse=True)
        return self.uniforms_at(stream, index[0], index[1], index[2] if len(shape) == 3 else np.zeros((1, 1), int))

    def row_uniforms(self, h: int, channels: int, stream: int) -> NDArray[np.float64]:
        """One uniform number per row and channel, [h, channels]; the same for every crop that has the row."""
        return replace(self, origin=(self.origin[0], 0)).uniforms((h, 1, channels), stream)[:, 0]

    def column_uniforms(self, w: int, channels: int, stream: int) -> NDArray[np.float64]:
        """One uniform number per column and channel, [w, channels]."""
        return replace(self, origin=(0, self.origin[1])).uniforms((1, w, channels), stream)[0]

    def uniforms_at(self, stream: int, rows: NDArray, cols: NDArray, channels: NDArray) -> NDArray[np.float64]:
        """One uniform number per (row, column, channel), numbered from the frame's first pixel; arrays broadcast.

        Returns:
            float64, odd multiples of 2**-53: neither 0 nor 1, and symmetric about 1/2.
        """
        rows, cols, channels = np.broadcast_arrays(rows + self.origin[0], cols + self.origin[1], channels)
        position = (rows.astype(np.uint64) << np.uint64(16)) | (cols.astype(np.uint64) >> np.uint64(1))
        effect = channels.astype(np.uint64) + np.uint64(stream * CHANNELS)
        view, frame = (np.full(position.shape, i, np.uint64) for i in (self.view, self.frame))
        first, second, third, fourth = philox((position, effect, view, frame), self.key)
        odd = cols % 2 == 1
        high, low = np.where(odd, third, first), np.where(odd, fourth, second)
        whole = (high << np.uint64(20)) | (low >> np.uint64(12))  # 52 bits: k + 1/2 is still exact in float64
        return (whole.astype(np.float64) + 0.5) * 2.0**-52
