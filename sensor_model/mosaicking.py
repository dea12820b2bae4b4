"""Colour filter array: which filter covers which pixel. Any size, odd ones too; row and column 0 are the pattern's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sensor_model.params import CFAS, Cfa, require


def channel_index(shape: tuple[int, int], cfa: Cfa) -> NDArray[np.intp]:
    """The channel (0 red, 1 green, 2 blue) over each pixel of an [h, w] frame."""
    require(cfa in CFAS, "cfa", f"one of {CFAS}", cfa)
    pattern = np.array(["RGB".index(letter) for letter in cfa]).reshape(2, 2)
    rows, cols = np.arange(shape[0]) % 2, np.arange(shape[1]) % 2
    return pattern[rows[:, None], cols[None, :]]


def mosaic(rgb: NDArray, cfa: Cfa) -> NDArray:
    """Keep, of each pixel's three channels, the one its filter lets through.

    Args:
        rgb: [h, w, 3], any size and dtype.
        cfa: Pattern of the upper left 2 x 2 pixels, in reading order.

    Returns:
        [h, w], dtype of `rgb`.

    Raises:
        ValueError: if `rgb` is not [h, w, 3] or the pattern is unknown.
    """
    require(rgb.ndim == 3 and rgb.shape[2] == 3, "rgb", "of shape [h, w, 3]", rgb.shape)
    index = channel_index(rgb.shape[:2], cfa)
    return np.take_along_axis(rgb, index[..., None], axis=2)[..., 0]
