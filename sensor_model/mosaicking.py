"""Colour filter array: which filter covers which pixel, and back to colour in every pixel.

A mosaic has any size, odd ones too; row and column 0 are the pattern's. Back: bilinear; Malvar, He, Cutler 2004; Menon,
Andriani, Calvagno 2007. Their arithmetic is that of colour-demosaicing 0.2.7 (Copyright 2015 Colour Developers,
BSD-3-Clause, see LICENSE_COLOUR_DEMOSAICING), which needs all of colour-science; a test compares them bit for bit.
The caller adds a border of surrounding pixels and cuts it off afterwards.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sensor_model.params import CFAS, Cfa, require

Image = NDArray[np.float64]
HALVES, THIRDS = np.array([0.5, 0, 0.5]), np.full(3, 1 / 3)


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


def bilinear(mosaic: Image, cfa: Cfa) -> Image:
    """[h, w] -> [h, w, 3]: means of the nearest pixels of each colour."""
    from scipy.ndimage import convolve  # for mosaics only: importing it takes a while

    channel = channel_index(mosaic.shape, cfa)
    cross, square = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4, np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    return np.stack([convolve(mosaic * (channel == c), cross if c == 1 else square) for c in range(3)], -1)


def malvar(mosaic: Image, cfa: Cfa) -> Image:
    """[h, w] -> [h, w, 3]: bilinear, corrected by the gradient of the colour that was measured there."""
    from scipy.ndimage import convolve

    channel = channel_index(mosaic.shape, cfa)
    at_green = channel == 1
    green = convolve(mosaic, np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1],
                                       [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8)  # fmt: skip
    beside = np.array([[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1],
                       [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]) / 8  # fmt: skip
    across, down = convolve(mosaic, beside), convolve(mosaic, beside.T)
    opposite = convolve(mosaic, np.array([[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5],
                                          [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]) / 8)  # fmt: skip
    planes = [np.where(at_green, mosaic, green)] * 3
    for c in (0, 2):
        filled = np.where(at_green, np.where(_rows_of(channel, c), across, down), opposite)
        planes[c] = np.where(channel == c, mosaic, filled)
    return np.stack(planes, -1)


def menon(mosaic: Image, cfa: Cfa) -> Image:
    """[h, w] -> [h, w, 3]: along the direction in which colour differences change less, then refined."""
    channel = channel_index(mosaic.shape, cfa)
    green, across = _directed_green(mosaic, channel == 1)
    colours = [np.where(channel == c, mosaic, 0.0) for c in range(3)]
    colours[1] = green
    for c in (0, 2):  # in pixels of green along the row or the column that has the colour
        along = np.where(_rows_of(channel, c), *_both(colours[c], HALVES))
        level = np.where(_rows_of(channel, c), *_both(green, HALVES))
        colours[c] = np.where(channel == 1, green + along - level, colours[c])
    sides = {c: (_chosen(across, colours[c], HALVES), _chosen(across, colours[2 - c], HALVES)) for c in (0, 2)}
    for c, (along, level) in sides.items():  # in pixels of the opposite colour
        colours[c] = np.where(channel == 2 - c, mosaic + along - level, colours[c])
    return _refined(colours, channel, across)


def _directed_green(mosaic: Image, at_green: NDArray[np.bool_]) -> tuple[Image, NDArray[np.bool_]]:
    """Green everywhere, and where it was interpolated across."""
    from scipy.ndimage import convolve

    near, far = np.array([0, 0.5, 0, 0.5, 0]), np.array([-0.25, 0, 0.5, 0, -0.25])
    classifier = np.array([[0, 0, 1, 0, 1], [0, 0, 0, 1, 0], [0, 0, 3, 0, 3], [0, 0, 0, 1, 0], [0, 0, 1, 0, 1.0]])
    greens, changes = [], []
    for axis, around in ((1, classifier), (0, classifier.T)):
        green = np.where(at_green, mosaic, _along(mosaic, near, axis) + _along(mosaic, far, axis))
        padded = np.pad(mosaic - green, [(0, 2 * (axis == 0)), (0, 2 * (axis == 1))], mode="reflect")
        change = np.abs(mosaic - green - (padded[:, 2:] if axis == 1 else padded[2:]))
        greens.append(green)
        changes.append(convolve(change, around, mode="constant"))
    across = changes[1] >= changes[0]
    return np.where(across, *greens), across


def _refined(colours: list[Image], channel: NDArray[np.intp], across: NDArray[np.bool_]) -> Image:
    """Colour differences smoothed along the direction of each pixel."""
    red, green, blue = colours
    for c, plane in ((0, red), (2, blue)):
        green = np.where(channel == c, plane - _chosen(across, plane - colours[1], THIRDS), green)
    planes = []
    for c, plane in ((0, red), (2, blue)):
        smooth = np.where(_rows_of(channel, c), *_both(plane - green, HALVES))
        planes.append(np.where(channel == 1, green + smooth, plane))
    red, blue = planes
    smooth = _chosen(across, red - blue, THIRDS)
    return np.stack([np.where(channel == 2, blue + smooth, red), green, np.where(channel == 0, red - smooth, blue)], -1)


def _rows_of(channel: NDArray[np.intp], c: int) -> NDArray[np.bool_]:
    """[h, 1]: the rows that have a colour."""
    return (channel == c).any(1)[:, None]


def _along(image: Image, taps: Image, axis: int) -> Image:
    from scipy.ndimage import convolve1d

    return convolve1d(image, taps, axis, mode="mirror")


def _both(image: Image, taps: Image) -> tuple[Image, Image]:
    """Across, and down."""
    return _along(image, taps, 1), _along(image, taps, 0)


def _chosen(across: NDArray[np.bool_], image: Image, taps: Image) -> Image:
    return np.where(across, *_both(image, taps))
