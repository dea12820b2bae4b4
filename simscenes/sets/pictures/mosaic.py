"""Whether gray pixels are the mosaic of a camera's colour filters: a pattern of two pixels that is everywhere.

Next to each other, pixels behind different filters differ by a share of the light, in every place with the same period.
The test compares the strength of that period with the strength of periods that are a little longer: edges, texture and
noise have both alike, a mosaic has only the one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SIDE = 16  # px of a block: the next periods are 2.3 and 2.7 px
WINDOW = 1024  # px in the middle of a picture that are looked at
# Times the power of the neighbours, and more by this over the root of the number of blocks. White noise has 1, the
# photographs of a fox at most 1.4, and few blocks scatter.
ABOVE, FEW = 3.0, 25.0
SHARE = 0.02  # of the light, and more: odd and even columns of a camera differ by less, filters by .1 to .5
DARKEST = 1.0  # % of the pixels: what they have counts as black
PAIRS = 0.25  # of the steps between pixels: a mosaic has as large ones in pairs as between them
BLOCKS = 8  # fewer of them decide nothing
# Green by which its two places must differ to be red and blue: of the light, and times what red and blue differ.
GREENS_APART, TIMES_OTHERS = 0.05, 4.0


def is_mosaic(*grays: NDArray[np.generic], flat: bool = False) -> bool:
    """Whether all of some pixels [h,w] have a pattern of two pixels across, down or both, as behind a filter array.

    Args:
        grays: The pixels.
        flat: Whether they show a uniform light, so that none of them is black.
    """
    blocks = np.concatenate([_blocks(gray) for gray in grays])
    if len(blocks) < BLOCKS or _is_doubled(blocks):
        return False
    light = blocks.mean((1, 2))
    # A slow change of light over a block has some of every period, unless its ends are faded out.
    fade = np.hanning(SIDE + 1)[:SIDE]
    strength = np.abs(np.fft.fft2((blocks - light[:, None, None]) * np.outer(fade, fade))) ** 2
    half, near = SIDE // 2, (SIDE // 2 - 3, SIDE // 2 - 2)
    own = strength[:, half, half] + strength[:, half, 0] + strength[:, 0, half]
    beside = strength[:, near, :][:, :, near].mean((1, 2)) + strength[:, near, 0].mean(1) + strength[:, 0, near].mean(1)
    times = ABOVE + FEW / np.sqrt(len(blocks))
    sure = float(np.median(own)) > times * float(np.median(beside)) and own.sum() > times * beside.sum()
    amplitude = np.sqrt(own) / fade.sum() ** 2
    black = 0.0 if flat else float(np.percentile(blocks, DARKEST))
    return bool(sure and np.median(amplitude) > SHARE * max(float(light.mean()) - black, 1e-9))


def is_shifted(light: NDArray[np.generic], cfa: str, least: float) -> bool:
    """Whether filters lie a row or a column beside where they are said: both places of green differ, and red is blue.

    Args:
        light: Of a mosaic [h,w], without black levels.
        cfa: The filters as they are said, row by row.
        least: What the two places of green differ by in any camera, in the unit of `light`.
    """
    even = light[: light.shape[0] // 2 * 2, : light.shape[1] // 2 * 2]  # as many pixels of each place
    places = [_blocks(even[y::2, x::2], SIDE // 2).mean((1, 2)) for y in (0, 1) for x in (0, 1)]
    green = [place for place, color in zip(places, cfa, strict=True) if color == "G"]
    other = [place for place, color in zip(places, cfa, strict=True) if color != "G"]
    if min(map(len, places)) < BLOCKS or len(green) != len(other):
        return False
    apart, apart_others = (float(np.median(np.abs(a - b))) for a, b in (green, other))
    return apart > max(least, GREENS_APART * float(np.median(places)), TIMES_OTHERS * apart_others)


def _is_doubled(blocks: NDArray[np.float64]) -> bool:
    """Whether pixels come in equal pairs: a picture that was enlarged twice has a period of two pixels as well."""
    for axis in (1, 2):
        steps = np.abs(np.diff(blocks, axis=axis)).mean(tuple({0, 1, 2} - {axis}))
        inside, between = steps[::2].mean(), steps[1::2].mean()
        if min(inside, between) < PAIRS * max(inside, between):
            return True
    return False


def _blocks(gray: NDArray[np.generic], side: int = SIDE) -> NDArray[np.float64]:
    """The blocks [n, side, side] of the middle of a picture."""
    h, w = gray.shape
    y, x = (max(0, length - WINDOW) // 2 for length in (h, w))
    part = gray[y : y + min(h, WINDOW) // side * side, x : x + min(w, WINDOW) // side * side].astype(np.float64)
    rows, columns = part.shape[0] // side, part.shape[1] // side
    return part.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(-1, side, side)


def refuse_mosaic(pixels: NDArray[np.generic], file: Path) -> None:
    """Raise ValueError if a gray picture, [h,w] or of equal channels [h,w,3], is the mosaic of a camera."""
    gray = pixels if pixels.ndim == 2 else pixels[..., 0]
    if pixels.ndim == 3 and not all((pixels[..., k] == gray).all() for k in range(1, min(3, pixels.shape[2]))):
        return
    if is_mosaic(gray):
        raise ValueError(f"{file} must be a developed picture, got gray pixels with a pattern of 2 x 2 over the whole "
                         "picture: it is probably the mosaic behind a camera's colour filters; give the camera's raw "
                         "file (DNG), or demosaic it to RGB first")  # fmt: skip
