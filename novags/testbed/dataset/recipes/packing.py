"""Mosaics, packed: pixels of one filter as a plane of half the size.

Planes are red, green of the red rows, green of the blue rows, blue, whatever the pattern of the camera.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.mosaicking import channel_index
from sensor_model.params import Cfa

SIDE = "must be even for a mosaic, whose cells are 2 x 2 px"


def packed(frame: NDArray[Any], cfa: Cfa) -> NDArray[Any]:
    """[h, w] -> [4, h/2, w/2], the same dtype; sides are even.

    Raises:
        ValueError: If they are not, or the frame is not a mosaic.
    """
    if frame.ndim != 2 or frame.shape[0] % 2 or frame.shape[1] % 2:
        raise ValueError(f"the shape of a frame [h, w] {SIDE}, got {list(frame.shape)}")
    pattern = channel_index((2, 2), cfa)
    reds = int(np.argwhere(pattern == 0)[0, 0])  # the row of a cell that has red
    order = sorted(((y, x) for y in (0, 1) for x in (0, 1)), key=lambda at: (pattern[at], at[0] != reds))
    return np.stack([frame[y::2, x::2] for y, x in order])


def planes(picture: NDArray[Any]) -> NDArray[Any]:
    """[h, w, c] -> [c, h, w], the same dtype."""
    return np.ascontiguousarray(np.moveaxis(picture, -1, 0))


def half_size(frame: NDArray[Any], cfa: Cfa) -> NDArray[np.float32]:
    """[h, w] -> [3, h/2, w/2]: red, the mean of both greens, blue. Errors as `packed`."""
    red, green, other, blue = packed(frame, cfa).astype(np.float32)
    return np.stack([red, (green + other) / 2, blue])


def half_size_intrinsics(K: NDArray[np.float64]) -> NDArray[np.float64]:
    """Intrinsics [3, 3] of pictures whose pixels are cells of 2 x 2: pixel edges stay in place, so whole rows halve.

    The planes of one cell are sampled a quarter of a packed pixel beside its centre; they count as its mean.
    """
    return K * np.array([0.5, 0.5, 1.0])[:, None]
