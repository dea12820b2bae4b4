"""Tile lists: which Gaussians reach which tile, nearest first.

Gaussians are visited in depth order, so one counting pass sorts the lists by tile and depth. Whether an ellipse
reaches a tile is decided exactly, for 4 x 4 tiles at once.
"""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..vectors.simd import LANES, bits, constant, lowest_bit, maximum, minimum, prefetch
from .record import BLOCK, LOG2_ALPHA_MIN, REACH_X, REACH_Y, ROW, SLOPE, TILE, TOP, A, K, Q, X, Y

HALF, ONE, ZERO = np.float32(0.5), np.float32(1.0), np.float32(0.0)
SLACK = np.float32(0.01)  # in log2 alpha: rounding must never drop a pixel that compositing would accept
COLUMNS = constant([lane % BLOCK for lane in range(LANES)])
ROWS = constant([lane // BLOCK for lane in range(LANES)])
CELLS = 4  # cells per side of the grid that one vector covers
EVERY, MORE, CORNER = 0xFFFF, 0x10000, 0x20000  # parts of a code of `first_grids`
INDEX = np.uint64(0xFFFFFFFF)  # the part of a sort key that is the Gaussian
AHEAD = 16  # Gaussians whose records are asked for ahead of their use: depth order is random order in memory


@inline
def cells_reached(x, y, a, k, q, slope, limit, size):
    """Bits of a 4 x 4 grid of cells, `size` pixels wide, in which a (dx + k dy)^2 + q dy^2 <= limit at a pixel centre.

    (x, y) is the ellipse's centre relative to the grid's corner. The minimum of the form over the box of a cell's pixel
    centres lies on the side that faces the centre: the nearest column with its best row, or the nearest row with its
    best column. (The box is continuous, so a cell may pass without a pixel in it that does; never the reverse.)
    """
    left, top = COLUMNS() * size + (HALF - x), ROWS() * size + (HALF - y)
    right, bottom = left + (size - ONE), top + (size - ONE)
    nearest_x, nearest_y = minimum(maximum(left, ZERO), right), minimum(maximum(top, ZERO), bottom)
    best_y = minimum(maximum(nearest_x * slope, top), bottom)
    u = nearest_x + best_y * k
    first = a * u * u + q * best_y * best_y
    best_x = minimum(maximum(nearest_y * (-k), left), right)
    u = best_x + nearest_y * k
    second = a * u * u + q * nearest_y * nearest_y
    return bits(minimum(first, second) <= limit)


@inline
def _tile_box(rows, i, tiles_x, tiles_y):
    """Range of tiles that the Gaussian's box can touch."""
    x, y, rx, ry = rows[i, X], rows[i, Y], rows[i, REACH_X], rows[i, REACH_Y]
    width, height = np.float32(tiles_x * TILE), np.float32(tiles_y * TILE)
    left, right = np.int64(max(x - rx, ZERO)) // TILE, np.int64(min(x + rx, width - ONE)) // TILE
    top, bottom = np.int64(max(y - ry, ZERO)) // TILE, np.int64(min(y + ry, height - ONE)) // TILE
    return left, right, top, bottom


@inline
def _grid(rows, i, tile_x, tile_y):
    """Bits of the tiles of a 4 x 4 grid that the Gaussian reaches."""
    x, y = rows[i, X] - np.float32(tile_x * TILE), rows[i, Y] - np.float32(tile_y * TILE)
    limit = rows[i, TOP] - LOG2_ALPHA_MIN + SLACK
    return cells_reached(x, y, rows[i, A], rows[i, K], rows[i, Q], rows[i, SLOPE], limit, np.float32(TILE))


@kernel
def find_open(begin, end, finished, tiles_x, tiles_y, open_tiles):
    """For tile rows begin..end-1: open_tiles [tiles] int64, the bits of the 4 x 4 tiles from there that take more."""
    for tile_y in range(begin, end):
        for tile_x in range(tiles_x):
            bits_ = 0
            for row in range(min(CELLS, tiles_y - tile_y)):
                for column in range(min(CELLS, tiles_x - tile_x)):
                    if not finished[(tile_y + row) * tiles_x + tile_x + column]:
                        bits_ |= 1 << (row * CELLS + column)
            open_tiles[tile_y * tiles_x + tile_x] = bits_


@kernel
def first_grids(begin, end, rows, order, first, n_chunks, n, tiles_x, tiles_y, open_tiles, codes):
    """Find the tiles that the first grid of each Gaussian of depth rank first..first+n-1 reaches, in n_chunks chunks.

    codes [n] int64 hold bits of tiles | MORE if its box takes more grids | corner tile * CORNER. A loop of its own,
    because then the latency of one Gaussian hides behind the next.
    """
    flat, last = rows.reshape(-1), len(order) - 1
    for rank in range(first + begin * n // n_chunks, first + end * n // n_chunks):
        i = np.int64(order[rank] & INDEX)
        prefetch(flat, np.int64(order[min(rank + AHEAD, last)] & INDEX) * ROW)
        left, right, top, bottom = _tile_box(rows, i, tiles_x, tiles_y)
        corner = top * tiles_x + left
        more = MORE if right - left >= CELLS or bottom - top >= CELLS else 0
        codes[rank - first] = (_grid(rows, i, left, top) & open_tiles[corner]) | more | (corner * CORNER)


@kernel
def visit(
    begin, end, filling, rows, order, first, n_chunks, n, tiles_x, tiles_y, open_tiles, codes, histogram, members,
    within, counts,
):  # fmt: skip
    """Count, or write, the lists of the Gaussians of depth rank first..first+n-1, in n_chunks chunks.

    Counting: histogram [chunks, tiles] becomes numbers of (Gaussian, tile) pairs. Filling: it holds where to write
    next; members[place] becomes a Gaussian, within[place] the number of its tiles before this one, counts [N] of all.
    Only tiles in open_tiles (of `find_open`) take more.
    """
    flat = rows.reshape(-1)
    for chunk in range(begin, end):
        if not filling:
            histogram[chunk] = 0
        for rank in range(first + chunk * n // n_chunks, first + (chunk + 1) * n // n_chunks):
            i, code = np.int64(order[rank] & INDEX), codes[rank - first]
            ahead = min(rank + AHEAD, first + n - 1)
            if codes[ahead - first] & MORE:
                prefetch(flat, np.int64(order[ahead] & INDEX) * ROW)
            corner = code // CORNER
            count = _list_grid(filling, code & EVERY, corner, tiles_x, i, 0, chunk, histogram, members, within)
            if code & MORE:
                left, right, top, bottom = _tile_box(rows, i, tiles_x, tiles_y)
                for tile_y in range(top, bottom + 1, CELLS):
                    for tile_x in range(left, right + 1, CELLS):
                        at = tile_y * tiles_x + tile_x
                        if open_tiles[at] and at != corner:
                            todo = _grid(rows, i, tile_x, tile_y) & open_tiles[at]
                            count = _list_grid(filling, todo, at, tiles_x, i, count, chunk, histogram, members, within)
            if filling:
                counts[i] = count


@inline
def _list_grid(filling, todo, corner, tiles_x, i, count, chunk, histogram, members, within):
    """Count or list Gaussian i in the tiles `todo` of the grid at `corner`; returns the number of its tiles so far."""
    while todo:
        cell = lowest_bit(todo)
        todo &= todo - 1
        tile = corner + (cell // CELLS) * tiles_x + cell % CELLS
        place = histogram[chunk, tile]
        histogram[chunk, tile] = place + 1
        if filling:
            members[place] = i
            within[place] = count
        count += 1
    return count
