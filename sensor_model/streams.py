"""Counter-based random numbers: every pixel of every effect owns one fixed draw.

Philox 4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011) maps a counter and a key to
128 random bits. Key: the seed. Counter: (row << 16 | column, effect and channel, view, frame). Nothing is hashed, so
two different draws never share a counter; no draw depends on another one, on the thread count, or on the size of the
frame: a crop equals the same crop of the whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensor_model.params import require

# Stream numbers. Pixel noise gives its first 64 bits to the shot noise and its last 64 to the read noise.
PIXEL, ROW, COLUMN, BANDING, RTS, DSNU, PRNU, HOT, RTS_SITE = range(9)
SHOT_WORD, READ_WORD = 0, 1

ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
WEYL = (0x9E3779B9, 0xBB67AE85)
MASK = 0xFFFFFFFF
SIDE = 1 << 16  # rows and columns are numbered in 16 bits each


def philox(counter: tuple[NDArray[np.uint64], ...], key: tuple[int, int]) -> tuple[NDArray[np.uint64], ...]:
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

    def uniforms(self, shape: tuple[int, ...], stream: int, word: int = 0) -> NDArray[np.float64]:
        """One uniform number in the open interval (0, 1) per pixel.

        Args:
            shape: (h, w) or (h, w, channels).
            stream: Which effect draws (PIXEL, ROW, ...).
            word: Which half of the 128 bits (0 or 1).

        Returns:
            float64 of that shape: odd multiples of 2**-53, so neither 0 nor 1, and symmetric about 1/2.
        """
        h, w = shape[:2]
        channels = shape[2] if len(shape) == 3 else 1
        end = (self.origin[0] + h, self.origin[1] + w)
        require(max(end) <= SIDE, "origin plus shape", f"within {SIDE} rows and columns", end)
        rows = np.arange(self.origin[0], end[0], dtype=np.uint64)[:, None, None]
        cols = np.arange(self.origin[1], end[1], dtype=np.uint64)[None, :, None]
        pixel = (rows << np.uint64(16)) | cols | np.zeros(channels, np.uint64)
        effect = np.broadcast_to(np.uint64(stream * 4) + np.arange(channels, dtype=np.uint64), pixel.shape)
        constant = [np.broadcast_to(np.uint64(i), pixel.shape) for i in (self.view, self.frame)]
        bits = philox((pixel, effect, *constant), (self.seed & MASK, self.seed >> 32))
        high, low = bits[2 * word], bits[2 * word + 1]
        whole = (high << np.uint64(20)) | (low >> np.uint64(12))  # 52 bits: k + 1/2 is still exact in float64
        return ((whole.astype(np.float64) + 0.5) * 2.0**-52).reshape(shape)
