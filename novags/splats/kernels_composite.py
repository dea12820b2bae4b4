"""CPU kernels: front-to-back compositing of tile lists, and its gradient.

A tile works on its 16 x 16 pixels in a cache-resident block, splat after splat, row by row; a row is the unit of culling
and one AVX-512 register (two AVX2 ones). A sorted splat is a row of GEOMETRY + D floats:

    mean x, mean y, A, k, Q, log2 o, channels...      log2 alpha = log2 o - A u^2 - Q dy^2,   u = dx + k dy

A pixel that has stopped (the next splat would take its transmittance below the limit) keeps that transmittance with a
negative sign: it then fails the same comparison for ever, without a mask of its own.
"""
# mypy: allow-untyped-defs
# numba infers the types of kernels; shapes are in the docstrings

import numpy as np
from numba import njit, prange

TILE = 16
GEOMETRY = 6
ALPHA_MAX = np.float32(0.999)
LOG2_ALPHA_MIN = np.float32(np.log2(1.0 / 255.0))
TRANSMITTANCE_MIN = np.float32(1e-4)
LOG2E = np.float32(np.log2(np.e))
CHECK_EVERY = 8  # splats between looks at who has stopped: a reduction in the pixel loop would forbid vectorising
SLACK = np.float32(0.01)  # pixels; culling must never drop a pixel that the comparison with alpha would accept
ZERO, HALF, ONE, TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
FAST = {"contract", "nsz"}
REDUCE = {"contract", "nsz", "reassoc"}  # horizontal sums in any, but fixed, order

# exp2 on [-8, 0] as (polynomial of x)^8: minimax fit to 2^(x/8); relative error 3e-6 after the powers, no integer tricks
E0, E1, E2 = np.float32(0.9999999250672567), np.float32(0.08664278158071038), np.float32(0.003752690460096807)
E3, E4, E5 = np.float32(0.00010796820868748897), np.float32(2.2433134359915706e-06), np.float32(2.864954588746977e-08)


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _exp2(x):
    p = E0 + x * (E1 + x * (E2 + x * (E3 + x * (E4 + x * E5))))
    p = p * p
    p = p * p
    return p * p


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def pack(splats, order, features, depths, with_depth, packed):
    """Gather visible splats and their channels in depth order: packed [V, GEOMETRY + D]."""
    for rank in prange(len(order)):
        i = order[rank]
        half = HALF * LOG2E
        packed[rank, 0] = splats[i, 0]
        packed[rank, 1] = splats[i, 1]
        packed[rank, 2] = splats[i, 2] * half
        packed[rank, 3] = splats[i, 3]
        packed[rank, 4] = splats[i, 4] * half
        packed[rank, 5] = np.log2(splats[i, 5])
        for d in range(features.shape[1]):
            packed[rank, GEOMETRY + d] = features[i, d]
        if with_depth:
            packed[rank, GEOMETRY + features.shape[1]] = depths[i]


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _rows(packed, rank, y0):
    """Rows [begin, end) of the tile that the splat can reach, and its centre relative to the tile's top."""
    y = packed[rank, 1] - np.float32(y0)
    reach = np.sqrt(max(ZERO, (packed[rank, 5] - LOG2_ALPHA_MIN) / packed[rank, 4])) + SLACK
    begin = np.int64(np.ceil(min(max(y - reach - HALF, ZERO), np.float32(TILE))))
    end = np.int64(np.floor(min(max(y + reach - HALF, -ONE), np.float32(TILE - 1)))) + 1
    return begin, end, y


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _forward_tile(packed, ranks, begin, end, x0, y0, trans, color, last, row_alive, weight):
    """Composite one tile; returns how many list entries were looked at."""
    n_channels = color.shape[0]
    for place in range(begin, end):
        if (place - begin) % CHECK_EVERY == 0:
            any_alive = False
            for r in range(TILE):
                alive = 0
                for lane in range(TILE):
                    alive += trans[r, lane] > ZERO
                row_alive[r] = alive > 0
                any_alive |= alive > 0
            if not any_alive:
                return place
        rank = ranks[place]
        row_begin, row_end, y = _rows(packed, rank, y0)
        x = packed[rank, 0] - np.float32(x0)
        A, k, Q, top = packed[rank, 2], packed[rank, 3], packed[rank, 4], packed[rank, 5]
        for r in range(row_begin, row_end):
            if not row_alive[r]:
                continue
            dy = np.float32(r) + HALF - y
            base = top - Q * dy * dy
            shift = k * dy - x + HALF
            half_width = np.sqrt(max(ZERO, (base - LOG2_ALPHA_MIN) / A)) + SLACK
            if -shift + half_width < ZERO or -shift - half_width > np.float32(TILE - 1):
                continue
            for lane in range(TILE):
                u = np.float32(lane) + shift
                power = base - A * u * u
                alpha = min(_exp2(power), ALPHA_MAX)
                alpha = alpha if power >= LOG2_ALPHA_MIN else ZERO
                before = trans[r, lane]
                after = before - before * alpha
                stop = after < TRANSMITTANCE_MIN
                weight[lane] = ZERO if stop else before * alpha
                trans[r, lane] = -abs(before) if stop else after
                last[r, lane] = last[r, lane] if stop else place
            for d in range(n_channels):
                c = packed[rank, GEOMETRY + d]
                for lane in range(TILE):
                    color[d, r, lane] += c * weight[lane]
    return end


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def composite_forward(packed, ranks, tile_starts, n_workers, image, transmittance, last, tile_ends):
    """Composite all tiles.

    Writes image [H, W, D], transmittance [H, W], last [H, W] int32 (one past the list index of the last splat that counted)
    and tile_ends [tiles] (one past the last list entry that was looked at).
    """
    height, width, n_channels = image.shape
    tiles_x = (width + TILE - 1) // TILE
    n_tiles = len(tile_ends)
    for worker in prange(n_workers):
        trans = np.empty((TILE, TILE), np.float32)
        color = np.empty((n_channels, TILE, TILE), np.float32)
        stop = np.empty((TILE, TILE), np.int32)
        row_alive = np.empty(TILE, np.bool_)
        weight = np.empty(TILE, np.float32)
        for tile in range(worker, n_tiles, n_workers):
            x0, y0 = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
            w, h = min(TILE, width - x0), min(TILE, height - y0)
            trans[:] = -ONE
            trans[:h, :w] = ONE
            color[:] = ZERO
            begin = tile_starts[tile]
            stop[:] = begin - 1
            tile_ends[tile] = _forward_tile(
                packed, ranks, begin, tile_starts[tile + 1], x0, y0, trans, color, stop, row_alive, weight
            )
            for r in range(h):
                for lane in range(w):
                    transmittance[y0 + r, x0 + lane] = abs(trans[r, lane])
                    last[y0 + r, x0 + lane] = stop[r, lane] + 1
                    for d in range(n_channels):
                        image[y0 + r, x0 + lane, d] = color[d, r, lane]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _backward_tile(packed, ranks, begin, end, x0, y0, trans, behind, v_color, last, row_last, sums, weight, v_rows):
    """Walk one tile's list back to front; writes one gradient row [GEOMETRY + D] for each list entry."""
    n_channels = v_color.shape[0]
    for place in range(end - 1, begin - 1, -1):
        rank = ranks[place]
        row_begin, row_end, y = _rows(packed, rank, y0)
        x = packed[rank, 0] - np.float32(x0)
        A, k, Q, top = packed[rank, 2], packed[rank, 3], packed[rank, 4], packed[rank, 5]
        sums[:] = ZERO
        for r in range(row_begin, row_end):
            if row_last[r] <= place:
                continue
            dy = np.float32(r) + HALF - y
            base = top - Q * dy * dy
            shift = k * dy - x + HALF
            half_width = np.sqrt(max(ZERO, (base - LOG2_ALPHA_MIN) / A)) + SLACK
            if -shift + half_width < ZERO or -shift - half_width > np.float32(TILE - 1):
                continue
            for lane in range(TILE):
                weight[1, lane] = ZERO
            for d in range(n_channels):
                c = packed[rank, GEOMETRY + d]
                for lane in range(TILE):
                    weight[1, lane] += c * v_color[d, r, lane]
            for lane in range(TILE):
                u = np.float32(lane) + shift
                power = base - A * u * u
                raw = _exp2(power)
                raw = raw if (power >= LOG2_ALPHA_MIN and place < last[r, lane]) else ZERO
                alpha = min(raw, ALPHA_MAX)
                inv = ONE / (ONE - alpha)
                before = trans[r, lane] * inv
                trans[r, lane] = before
                w = alpha * before
                weight[0, lane] = w
                dot = weight[1, lane]
                v_alpha = before * dot - behind[r, lane] * inv
                behind[r, lane] += w * dot
                g = v_alpha * alpha if raw <= ALPHA_MAX else ZERO  # a capped alpha has no slope
                gu = g * u
                sums[0, lane] += g
                sums[1, lane] += gu
                sums[2, lane] += gu * u
                sums[3, lane] += gu * dy
                sums[4, lane] += g * dy
                sums[5, lane] += g * dy * dy
            for d in range(n_channels):
                for lane in range(TILE):
                    sums[GEOMETRY + d, lane] += weight[0, lane] * v_color[d, r, lane]
        _write_row(sums, A, k, Q, top, v_rows, place)


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _write_row(sums, A, k, Q, top, v_rows, place):
    a, q = A * (TWO / LOG2E), Q * (TWO / LOG2E)
    s = _horizontal(sums, 0), _horizontal(sums, 1), _horizontal(sums, 2), _horizontal(sums, 3)
    s4, s5 = _horizontal(sums, 4), _horizontal(sums, 5)
    v_rows[place, 0] = a * s[1]
    v_rows[place, 1] = a * k * s[1] + q * s4
    v_rows[place, 2] = -HALF * s[2]
    v_rows[place, 3] = -a * s[3]
    v_rows[place, 4] = -HALF * s5
    v_rows[place, 5] = s[0]
    for d in range(GEOMETRY, len(sums)):
        v_rows[place, d] = _horizontal(sums, d)


@njit(cache=True, fastmath=REDUCE)
def _horizontal(sums, row):
    total = ZERO
    for lane in range(TILE):
        total += sums[row, lane]
    return total


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def composite_backward(
    packed, ranks, tile_starts, tile_ends, n_workers, transmittance, last, v_image, v_transmittance, v_rows
):
    """Gradient rows v_rows [I, GEOMETRY + D] of all list entries: d/d(mean x, mean y, a, k, q, ln o, channels).

    v_image [H, W, D] and v_transmittance [H, W] are the gradients of the outputs of `composite_forward`.
    """
    height, width, n_channels = v_image.shape
    tiles_x = (width + TILE - 1) // TILE
    n_tiles = len(tile_ends)
    for worker in prange(n_workers):
        trans = np.empty((TILE, TILE), np.float32)
        behind = np.empty((TILE, TILE), np.float32)
        v_color = np.empty((n_channels, TILE, TILE), np.float32)
        stop = np.empty((TILE, TILE), np.int32)
        row_last = np.empty(TILE, np.int32)
        sums = np.empty((GEOMETRY + n_channels, TILE), np.float32)
        weight = np.empty((2, TILE), np.float32)
        for tile in range(worker, n_tiles, n_workers):
            x0, y0 = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
            w, h = min(TILE, width - x0), min(TILE, height - y0)
            trans[:] = ONE
            behind[:] = ZERO
            v_color[:] = ZERO
            stop[:] = -1
            for r in range(h):
                for lane in range(w):
                    t = transmittance[y0 + r, x0 + lane]
                    trans[r, lane] = t
                    # what lies behind the last splat: transmittance itself, as if it were one more contribution
                    behind[r, lane] = t * v_transmittance[y0 + r, x0 + lane]
                    stop[r, lane] = last[y0 + r, x0 + lane]
                    for d in range(n_channels):
                        v_color[d, r, lane] = v_image[y0 + r, x0 + lane, d]
            for r in range(TILE):
                row_last[r] = stop[r].max()
            v_rows[tile_ends[tile] : tile_starts[tile + 1]] = ZERO
            _backward_tile(
                packed, ranks, tile_starts[tile], tile_ends[tile], x0, y0, trans, behind, v_color, stop, row_last, sums,
                weight, v_rows,
            )  # fmt: skip


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def gather_gradients(v_rows, offsets, places, order, opacities, n_features, v_splats, v_features, v_depths):
    """Sum the gradient rows of each splat, in a fixed order: no atomics, so the same bits for any number of threads.

    Writes v_splats [N, GEOMETRY], v_features [N, n_features] and v_depths [N] for the visible Gaussians.
    """
    n_channels = v_rows.shape[1]
    for rank in prange(len(order)):
        i = order[rank]
        total = np.zeros(n_channels, np.float32)
        for slot in range(offsets[rank], offsets[rank + 1]):
            for d in range(n_channels):
                total[d] += v_rows[places[slot], d]
        for d in range(5):
            v_splats[i, d] = total[d]
        v_splats[i, 5] = total[5] / opacities[i]
        for d in range(n_features):
            v_features[i, d] = total[GEOMETRY + d]
        if n_channels > GEOMETRY + n_features:
            v_depths[i] = total[GEOMETRY + n_features]
