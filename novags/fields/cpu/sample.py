"""Where rays are sampled: in proportion to the weights that a coarse map of the densities gives them.

Geometry is `box.contracted` and `box.distance_at`. The map holds one density per cell of the unit cube.
"""

# mypy: allow-untyped-defs

import numpy as np

from novags.fields.cpu.encode import cell_index
from novags.splats.cpu.compiler import inline, kernel

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
SHELL, INNER = np.float32(0.5), np.float32(0.75)  # as in box.py
BINS = 224  # in which the map is looked at along a ray: a wall of one cell must not fall between two
SPREAD = 4  # bins to either side that a bin's weight is spread over: the map is coarse, and late
TINY = np.float32(1e-12)  # of a sum of weights: 0 / 0 where the map is empty and no share is spread evenly


@inline
def _distance(s, near, middle, far):
    if s <= INNER:
        return near + (middle - near) * s / INNER
    return middle / (ONE - (s - INNER) / (ONE - INNER) * (ONE - middle / far))


@inline
def _contract(x, y, z, out, row):
    """Writes the place in the unit cube of a point in box coordinates."""
    r = max(max(abs(x), abs(y)), max(abs(z), ONE))
    f = (ONE + SHELL - SHELL / (ONE + (r - ONE) / SHELL)) / r
    scale, shift = ONE / (ONE + ONE + SHELL + SHELL), HALF
    out[row, 0] = x * f * scale + shift
    out[row, 1] = y * f * scale + shift
    out[row, 2] = z * f * scale + shift


@kernel
def sample(
    begin, end, origins, directions, reach, unit, density, side, jitter, even, distances, widths, positions
):  # fmt: skip
    """Samples of rays begin..end-1 between the N + 1 edges that the map's weights put along each.

    origins, directions [R, 3] in box coordinates, the directions per world unit of length; reach: near, middle, far;
    unit: length in which densities count; density [side^3]; jitter [R, N + 1] in 0..1; even: share of the samples that
    is spread evenly. Writes distances [R, N] of the samples (world), widths [R, N] of their intervals (units), and
    positions [R * N, 3] in the unit cube.
    """
    n = distances.shape[1]
    near, middle, far = reach[0], reach[1], reach[2]
    place, weights, sums = np.empty((1, 3), np.float32), np.empty(BINS, np.float32), np.empty(BINS + 1, np.float32)
    for ray in range(begin, end):
        through, before = ONE, near
        for i in range(BINS):
            after = _distance(np.float32(i + 1) / np.float32(BINS), near, middle, far)
            t = before + (after - before) * jitter[ray, i % (n + 1)]
            _contract(
                origins[ray, 0] + t * directions[ray, 0], origins[ray, 1] + t * directions[ray, 1],
                origins[ray, 2] + t * directions[ray, 2], place, 0,
            )  # fmt: skip
            left = np.exp(-density[cell_index(place, 0, side)] * (after - before) / unit)
            weights[i] = through * (ONE - left)
            through *= left
            before = after
        _cumulate(weights, sums, even)
        k, last = 0, ZERO
        for j in range(n + 1):
            u = (np.float32(j) + jitter[ray, j]) / np.float32(n + 1)
            while k < BINS - 1 and sums[k + 1] < u:
                k += 1
            part = min(max((u - sums[k]) / max(sums[k + 1] - sums[k], TINY), ZERO), ONE)
            edge = _distance((np.float32(k) + part) / np.float32(BINS), near, middle, far)
            if j > 0:
                t = HALF * (last + edge)
                distances[ray, j - 1] = t
                widths[ray, j - 1] = max(edge - last, ZERO) / unit
                _contract(
                    origins[ray, 0] + t * directions[ray, 0], origins[ray, 1] + t * directions[ray, 1],
                    origins[ray, 2] + t * directions[ray, 2], positions, ray * n + j - 1,
                )  # fmt: skip
            last = edge


@inline
def _cumulate(weights, sums, even):
    """Sums [BINS + 1] from 0 to 1 of the weights, each spread over its neighbours, and of the even share."""
    total = ZERO
    sums[0] = ZERO
    for i in range(BINS):
        here = weights[i]
        left, right = here, here
        for k in range(1, SPREAD + 1):
            left, right = max(left, weights[max(i - k, 0)]), max(right, weights[min(i + k, BINS - 1)])
        total += HALF * (left + right)
        sums[i + 1] = total
    share = (ONE - even) / max(total, TINY)
    rest = even if total > TINY else ONE
    for i in range(1, BINS + 1):
        sums[i] = sums[i] * share + rest * np.float32(i) / np.float32(BINS)


@kernel
def learn(positions, found, side, kept, density):
    """Update the map [side^3] with the densities found [S] at positions [S, 3]; in order, by one thread.

    A cell becomes at least as dense as its samples, and otherwise keeps the share `kept` of its excess: fog that has
    gone must not be sampled for ever.
    """
    for s in range(len(positions)):
        at = cell_index(positions, s, side)
        density[at] = found[s] + max(density[at] - found[s], ZERO) * kept
