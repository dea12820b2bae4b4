"""Interpolation of the tables' features, and its gradient.

Positions lie in the unit cube. Work is done level by level, so that one table at a time is in the caches.
"""

# mypy: allow-untyped-defs

import numpy as np

from novags.splats.cpu.compiler import inline, kernel

ZERO, ONE = np.float32(0.0), np.float32(1.0)
CHUNK = 4096  # samples that go through one level before the next
PRIME_Y, PRIME_Z = np.uint32(2654435761), np.uint32(805459861)  # of the hash, Mueller et al. 2022, equation 4


@inline
def row_of(x, y, z, resolution, rows):
    """Row of the corner (x, y, z) in a level's table."""
    side = resolution + 1
    if side * side * side <= rows:
        return (z * side + y) * side + x
    mixed = np.uint32(x) ^ (np.uint32(y) * PRIME_Y) ^ (np.uint32(z) * PRIME_Z)
    return np.int64(mixed & np.uint32(rows - 1))


@inline
def cell_of(value, resolution):
    """Lower corner along an axis, and how far beyond it."""
    scaled = value * np.float32(resolution)
    low = min(max(np.int64(scaled), 0), resolution - 1)
    return low, scaled - np.float32(low)


@kernel
def forward(begin, end, positions, table, resolutions, starts, encoded):
    """encoded[s, 4 level : 4 level + 4] for the samples begin..end-1.

    positions [S, 3], table [rows * 4], resolutions [8], starts [9], encoded [S, 32].
    """
    for first in range(begin, end, CHUNK):
        last = min(first + CHUNK, end)
        for level in range(len(resolutions)):
            resolution, start = resolutions[level], starts[level]
            rows = starts[level + 1] - start
            for s in range(first, last):
                x, fx = cell_of(positions[s, 0], resolution)
                y, fy = cell_of(positions[s, 1], resolution)
                z, fz = cell_of(positions[s, 2], resolution)
                a, b, c, d = ZERO, ZERO, ZERO, ZERO
                for corner in range(8):
                    i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
                    w = (fx if i else ONE - fx) * (fy if j else ONE - fy) * (fz if k else ONE - fz)
                    at = 4 * (start + row_of(x + i, y + j, z + k, resolution, rows))
                    a += w * table[at]
                    b += w * table[at + 1]
                    c += w * table[at + 2]
                    d += w * table[at + 3]
                encoded[s, 4 * level] = a
                encoded[s, 4 * level + 1] = b
                encoded[s, 4 * level + 2] = c
                encoded[s, 4 * level + 3] = d


@inline
def cell_index(positions, s, side):
    """Index of the cell of a z-major map of the unit cube that a position lies in, or is nearest to."""
    x, _ = cell_of(positions[s, 0], side)
    y, _ = cell_of(positions[s, 1], side)
    z, _ = cell_of(positions[s, 2], side)
    return (z * side + y) * side + x


@kernel
def add_seeded(begin, end, positions, seeded, side, more, raw):
    """raw[s, 0] += more for the samples begin..end-1 in cells that are not 0 in seeded [side^3]."""
    for s in range(begin, end):
        if seeded[cell_index(positions, s, side)]:
            raw[s, 0] += more


@kernel
def backward(begin, end, positions, v_encoded, resolutions, starts, v_table):
    """Gradients of the tables of levels begin..end-1 from v_encoded [S, 32]; v_table [rows * 4] is overwritten.

    A level belongs to one thread, and its sums run over the samples in order: they do not depend on the threads.
    """
    for level in range(begin, end):
        resolution, start = resolutions[level], starts[level]
        rows = starts[level + 1] - start
        for i in range(4 * start, 4 * starts[level + 1]):
            v_table[i] = ZERO
        for s in range(len(positions)):
            a, b = v_encoded[s, 4 * level], v_encoded[s, 4 * level + 1]
            c, d = v_encoded[s, 4 * level + 2], v_encoded[s, 4 * level + 3]
            if a == ZERO and b == ZERO and c == ZERO and d == ZERO:
                continue
            x, fx = cell_of(positions[s, 0], resolution)
            y, fy = cell_of(positions[s, 1], resolution)
            z, fz = cell_of(positions[s, 2], resolution)
            for corner in range(8):
                i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
                w = (fx if i else ONE - fx) * (fy if j else ONE - fy) * (fz if k else ONE - fz)
                at = 4 * (start + row_of(x + i, y + j, z + k, resolution, rows))
                v_table[at] += w * a
                v_table[at + 1] += w * b
                v_table[at + 2] += w * c
                v_table[at + 3] += w * d
