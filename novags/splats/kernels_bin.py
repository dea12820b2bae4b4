"""CPU kernels: depth order and tile lists.

Splats are sorted once by depth (stable radix sort, ties by index); the tile lists then come out depth-sorted from one
counting pass, because splats are visited in depth order. Results do not depend on the number of threads.
"""
# mypy: allow-untyped-defs
# numba infers the types of kernels; shapes are in the docstrings

import numpy as np
from numba import njit, prange

TILE = 16  # pixels; one row of a tile is one AVX-512 register
HALF = np.float32(0.5)
ZERO = np.float32(0.0)
SLACK = np.float32(0.01)  # pixels; rounding must never drop a pixel that the compositing would accept
FAST = {"contract", "nsz"}


@njit(cache=True)
def depth_order(depths, radii, order):
    """Write the indices of the visible Gaussians (radius > 0), nearest first, to order; return their number."""
    n = 0
    for i in range(len(depths)):
        if radii[i] > 0:
            order[n] = i
            n += 1
    keys = depths.view(np.uint32)  # positive floats sort like their bit patterns
    other = np.empty(n, np.int32)
    source, target = order[:n], other
    for shift in (0, 11, 22):
        starts = np.zeros(2048, np.int64)
        for j in range(n):
            starts[(keys[source[j]] >> shift) & 2047] += 1
        total = 0
        for b in range(2048):
            count = starts[b]
            starts[b] = total
            total += count
        for j in range(n):
            b = (keys[source[j]] >> shift) & 2047
            target[starts[b]] = source[j]
            starts[b] += 1
        source, target = target, source
    order[:n] = source
    return n


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _columns(x, y, a, k, q, ex, ey, width, y0, y1):
    """Pixel columns [first, last] where the splat's ellipse meets pixel centres of rows y0..y1-1; empty if last < first.

    The ellipse is a u^2 + q dy^2 <= reach^2 with extents ex, ey; so reach^2 = q ey^2.
    """
    low = max(np.float32(y0) + HALF - y, -ey)
    high = min(np.float32(y1) - HALF - y, ey)
    if low > high:
        return 0, -1
    # The rightmost point has dy = tangent, the leftmost -tangent; where a band misses it, the band's nearest row is extreme.
    tangent = -k * ey * ey / ex
    right_dy = min(max(tangent, low), high)
    left_dy = min(max(-tangent, low), high)
    right = x - k * right_dy + np.sqrt(max(ZERO, q * (ey * ey - right_dy * right_dy) / a)) + SLACK
    left = x - k * left_dy - np.sqrt(max(ZERO, q * (ey * ey - left_dy * left_dy) / a)) - SLACK
    first = np.int64(np.ceil(min(max(left - HALF, ZERO), np.float32(width))))
    last = np.int64(np.floor(min(max(right - HALF, -HALF), np.float32(width - 1))))
    return first, last


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _tile_rows(y, ey, height):
    """First tile row and one past the last that the splat can touch."""
    low = np.int64(min(max(y - ey - SLACK, ZERO), np.float32(height))) // TILE
    high = np.int64(min(max(y + ey + SLACK, -HALF), np.float32(height - 1))) // TILE
    return low, high + 1


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def count_tiles(splats, order, width, height, n_chunks, counts, histogram):
    """Count the tiles of each splat in `order` (counts [V] int64) and of each chunk of splats (histogram [n_chunks, tiles])."""
    tiles_x = (width + TILE - 1) // TILE
    n = len(order)
    for chunk in prange(n_chunks):
        histogram[chunk] = 0
        for rank in range(chunk * n // n_chunks, (chunk + 1) * n // n_chunks):
            x, y, a, k, q, ex, ey = _shape(splats, order[rank])
            begin, end = _tile_rows(y, ey, height)
            total = 0
            for ty in range(begin, end):
                first, last = _columns(x, y, a, k, q, ex, ey, width, ty * TILE, ty * TILE + TILE)
                if first <= last:
                    for tx in range(first // TILE, last // TILE + 1):
                        histogram[chunk, ty * tiles_x + tx] += 1
                        total += 1
            counts[rank] = total


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _shape(splats, i):
    return splats[i, 0], splats[i, 1], splats[i, 2], splats[i, 3], splats[i, 4], splats[i, 6], splats[i, 7]


@njit(cache=True)
def prefix_sums(counts, histogram, offsets, tile_starts):
    """Turn counts into offsets [V + 1], and histogram into each chunk's write position in each tile's list, in place."""
    total = 0
    for rank in range(len(counts)):
        offsets[rank] = total
        total += counts[rank]
    offsets[len(counts)] = total
    total = 0
    for tile in range(histogram.shape[1]):
        tile_starts[tile] = total
        for chunk in range(histogram.shape[0]):
            count = histogram[chunk, tile]
            histogram[chunk, tile] = total
            total += count
    tile_starts[histogram.shape[1]] = total
    return total


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def fill_tiles(splats, order, width, height, n_chunks, histogram, offsets, ranks, places):
    """Write the tile lists.

    ranks [I]: depth rank of each intersection, tile after tile, nearest first. places [I]: for the intersections of one
    splat, which lie together from offsets[rank], their index in ranks.
    """
    tiles_x = (width + TILE - 1) // TILE
    n = len(order)
    for chunk in prange(n_chunks):
        for rank in range(chunk * n // n_chunks, (chunk + 1) * n // n_chunks):
            x, y, a, k, q, ex, ey = _shape(splats, order[rank])
            begin, end = _tile_rows(y, ey, height)
            slot = offsets[rank]
            for ty in range(begin, end):
                first, last = _columns(x, y, a, k, q, ex, ey, width, ty * TILE, ty * TILE + TILE)
                if first <= last:
                    for tx in range(first // TILE, last // TILE + 1):
                        tile = ty * tiles_x + tx
                        place = histogram[chunk, tile]
                        histogram[chunk, tile] = place + 1
                        ranks[place] = rank
                        places[slot] = place
                        slot += 1
