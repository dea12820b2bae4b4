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
ABOVE = 12.0  # times the power of the neighbours; white noise has 1, and ten blocks scatter by less than half of it
SHARE = 0.02  # of the mean light, and more: odd and even columns of a camera differ by less, filters by .1 to .5
BLOCKS = 8  # fewer of them decide nothing


def is_mosaic(*grays: NDArray[np.generic]) -> bool:
    """Whether all of some pixels [h,w] have a pattern of two pixels across, down or both, as behind a filter array."""
    blocks = np.concatenate([_blocks(gray) for gray in grays])
    if len(blocks) < BLOCKS:
        return False
    light = blocks.mean((1, 2))
    # A slow change of light over a block has some of every period, unless its ends are faded out.
    fade = np.hanning(SIDE + 1)[:SIDE]
    strength = np.abs(np.fft.fft2((blocks - light[:, None, None]) * np.outer(fade, fade))) ** 2
    half, near = SIDE // 2, (SIDE // 2 - 3, SIDE // 2 - 2)
    own = strength[:, half, half] + strength[:, half, 0] + strength[:, 0, half]
    beside = strength[:, near, :][:, :, near].mean((1, 2)) + strength[:, near, 0].mean(1) + strength[:, 0, near].mean(1)
    sure = float(np.median(own)) > ABOVE * float(np.median(beside)) and own.sum() > ABOVE * beside.sum()
    amplitude = np.sqrt(own) / fade.sum() ** 2
    return bool(sure and np.median(amplitude) > SHARE * max(float(light.mean()), 1e-9))


def _blocks(gray: NDArray[np.generic]) -> NDArray[np.float64]:
    """The blocks [n, SIDE, SIDE] of the middle of a picture."""
    h, w = gray.shape
    y, x = (max(0, side - WINDOW) // 2 for side in (h, w))
    part = gray[y : y + min(h, WINDOW) // SIDE * SIDE, x : x + min(w, WINDOW) // SIDE * SIDE].astype(np.float64)
    rows, columns = part.shape[0] // SIDE, part.shape[1] // SIDE
    return part.reshape(rows, SIDE, columns, SIDE).swapaxes(1, 2).reshape(-1, SIDE, SIDE)


def refuse_mosaic(pixels: NDArray[np.generic], file: Path) -> None:
    """Raise ValueError if a gray picture, [h,w] or of equal channels [h,w,3], is the mosaic of a camera."""
    gray = pixels if pixels.ndim == 2 else pixels[..., 0]
    if pixels.ndim == 3 and not all((pixels[..., k] == gray).all() for k in range(1, min(3, pixels.shape[2]))):
        return
    if is_mosaic(gray):
        raise ValueError(f"{file} must be a developed picture, got gray pixels with a pattern of 2 x 2 over the whole "
                         "picture: it is probably the mosaic behind a camera's colour filters; give the camera's raw "
                         "file (DNG), or demosaic it to RGB first")  # fmt: skip
