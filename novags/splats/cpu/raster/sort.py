"""Depth order by a stable least-significant-digit radix sort; ties keep the order of the Gaussians."""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import kernel

DIGIT = 11  # bits; 2048 counters of 4 bytes stay in the first-level cache
GRAIN = 4096


@kernel
def count_visible(begin, end, radii, tiles, n_chunks, depths, counts, tile_counts, low, high):
    """Visible Gaussians of each chunk, the tiles they touch at most, and their range of depth bits.

    Positive floats sort like the integers of their bits.
    """
    n = len(radii)
    keys = depths.view(np.uint32)
    for chunk in range(begin, end):
        total, n_tiles, smallest, largest = 0, 0, np.uint32(0xFFFFFFFF), np.uint32(0)
        for i in range(chunk * n // n_chunks, (chunk + 1) * n // n_chunks):
            if radii[i] > 0:
                total += 1
                n_tiles += tiles[i]
                smallest, largest = min(smallest, keys[i]), max(largest, keys[i])
        counts[chunk], tile_counts[chunk], low[chunk], high[chunk] = total, n_tiles, smallest, largest


@kernel
def fill_visible(begin, end, radii, n_chunks, depths, starts, low, pairs):
    """Write (depth bits - low) << 32 | index of the visible Gaussians, in order."""
    n = len(radii)
    keys = depths.view(np.uint32)
    for chunk in range(begin, end):
        place = starts[chunk]
        for i in range(chunk * n // n_chunks, (chunk + 1) * n // n_chunks):
            if radii[i] > 0:
                pairs[place] = (np.uint64(keys[i] - low) << np.uint64(32)) | np.uint64(i)
                place += 1


@kernel
def count_digits(begin, end, pairs, n_chunks, shift, histogram):
    """Histogram [chunks, 2^DIGIT] of one digit."""
    n = len(pairs)
    digit_mask = np.uint64(histogram.shape[1] - 1)
    for chunk in range(begin, end):
        histogram[chunk] = 0
        for j in range(chunk * n // n_chunks, (chunk + 1) * n // n_chunks):
            histogram[chunk, (pairs[j] >> shift) & digit_mask] += 1


@kernel
def exclusive_sums(histogram):
    """Turn a histogram [chunks, bins] into write positions, bin by bin, in it chunk by chunk; returns the total."""
    total = 0
    for b in range(histogram.shape[1]):
        for chunk in range(histogram.shape[0]):
            count = histogram[chunk, b]
            histogram[chunk, b] = total
            total += count
    return total


@kernel
def move_digits(begin, end, pairs, n_chunks, shift, histogram, moved):
    """One stable pass."""
    n = len(pairs)
    digit_mask = np.uint64(histogram.shape[1] - 1)
    for chunk in range(begin, end):
        for j in range(chunk * n // n_chunks, (chunk + 1) * n // n_chunks):
            b = (pairs[j] >> shift) & digit_mask
            moved[histogram[chunk, b]] = pairs[j]
            histogram[chunk, b] += 1
