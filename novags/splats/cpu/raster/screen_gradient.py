"""Gradients with respect to the projected centres, and the sums of their absolute values over pixels (AbsGS).

Ye et al. 2024, "AbsGS". Only densification strategies use these, so this is a separate scalar walk: the fast backward
pass does not pay for it.
"""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..memory import empty
from ..parallel import run
from ..pipeline import RasterFrame
from . import composite
from .record import ALPHA_MAX, BLOCK, CHANNEL, CHANNELS, HALF_LOG2E, LOG2_ALPHA_MIN, TILE, TOP, A, K, Q, X, Y

ZERO, HALF, ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
PIXELS, LANES = composite.PIXELS, BLOCK * BLOCK
SIDE = TILE // BLOCK
GRAIN_TILES = 2


def screen_gradient(frame: RasterFrame, v_image: np.ndarray, v_alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """dL/d means2d [N, 2], and the sum over pixels of its absolute value [N, 2].

    Args:
        frame: As `pipeline.forward` left it.
        v_image: dL/d image [H, W, D], float32.
        v_alpha: dL/d alpha [H, W], float32.
    """
    camera, n = frame.camera, len(frame.splats.depths)
    n_tiles = camera.tiles_x * camera.tiles_y
    rows, state = frame.passes[0]
    features = np.concatenate([channels[:, CHANNEL : CHANNEL + CHANNELS] for channels, _ in frame.passes], 1)
    left = np.abs(state.trans[: n_tiles * PIXELS])
    behind = -_tiled(v_alpha, camera.tiles_x, camera.tiles_y) * left  # as if the background were one more Gaussian
    sums = np.zeros((4, n))
    for wave, reached in reversed(list(zip(frame.waves, state.reached, strict=True))):
        out = empty((len(wave.members), 4))
        run(
            _walk, n_tiles, GRAIN_TILES, rows, features, wave.members, reached, wave.starts, wave.ends, wave.list_ends,
            wave.base, camera.width, camera.height, camera.tiles_x, state.last, v_image, left, behind, out,
        )  # fmt: skip
        for i in range(4):
            sums[i] += np.bincount(wave.members, out[:, i], n)
    total = np.ascontiguousarray(sums.T.astype(np.float32))
    return total[:, :2], total[:, 2:]


def _tiled(image: np.ndarray, tiles_x: int, tiles_y: int) -> np.ndarray:
    """An image [H, W] in the order of the tiles' pixels, padded with 0."""
    padded = np.zeros((tiles_y * TILE, tiles_x * TILE), np.float32)
    padded[: image.shape[0], : image.shape[1]] = image
    return padded.reshape(tiles_y, SIDE, BLOCK, tiles_x, SIDE, BLOCK).transpose(0, 3, 1, 4, 2, 5).reshape(-1)


@kernel
def _walk(
    begin, end, rows, features, members, reached, starts, ends, list_ends, base, width, height, tiles_x, last, v_image,
    left, behind, out,
):  # fmt: skip
    """Rows of `out` [I, 4] for the lists of tiles begin..end-1, back to front; left, behind as in `composite`."""
    for tile in range(begin, end):
        x0, y0 = tile % tiles_x * TILE, tile // tiles_x * TILE
        for place in range(ends[tile], list_ends[tile]):
            out[place] = ZERO
        for place in range(ends[tile] - 1, starts[tile] - 1, -1):
            i = members[place]
            sums = ZERO, ZERO, ZERO, ZERO
            for block in range(PIXELS // LANES):
                if np.int64(reached[place]) >> block & 1:
                    for lane in range(LANES):
                        x, y = x0 + block % SIDE * BLOCK + lane % BLOCK, y0 + block // SIDE * BLOCK + lane // BLOCK
                        pixel = tile * PIXELS + block * LANES + lane
                        if x < width and y < height and last[pixel] > base + place:
                            gx, gy = _pixel(rows[i], features[i], x, y, pixel, v_image[y, x], left, behind)
                            sums = sums[0] + gx, sums[1] + gy, sums[2] + abs(gx), sums[3] + abs(gy)
            out[place, 0], out[place, 1], out[place, 2], out[place, 3] = sums


@inline
def _pixel(row, features, x, y, pixel, v_color, left, behind):
    """Gradient of the centre from one pixel; moves the pixel's state to in front of the Gaussian."""
    dy = np.float32(y) + HALF - row[Y]
    u = np.float32(x) + HALF - row[X] + row[K] * dy
    power = row[TOP] - row[Q] * dy * dy - row[A] * u * u
    if not power >= LOG2_ALPHA_MIN:
        return ZERO, ZERO
    uncapped = np.float32(2.0) ** power
    alpha = min(uncapped, ALPHA_MAX)
    inverse = ONE / (ONE - alpha)
    before = left[pixel] * inverse
    light = ZERO
    for channel in range(len(v_color)):
        light += v_color[channel] * features[channel]
    g = alpha * (before * light - behind[pixel] * inverse)
    left[pixel] = before
    behind[pixel] += alpha * before * light
    if uncapped > ALPHA_MAX:
        return ZERO, ZERO
    return g * row[A] * u / HALF_LOG2E, g * (row[A] * row[K] * u + row[Q] * dy) / HALF_LOG2E
