"""Front-to-back compositing of tile lists, and its gradient.

A tile is sixteen blocks of 4 x 4 pixels, each one vector; all of its state stays in the first-level cache. For each
Gaussian a bit per block says whether it is reached; only those blocks are touched. Tile state, in blocks of sixteen
floats:

    trans [tiles, 256]       transmittance; negative once the pixel has stopped, so that it fails the same test for ever
    color [tiles, 4, 256]    four channels
    last  [tiles, 256]       int32; the place in the lists at which the pixel stopped; 0 outside the image
"""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..vectors.simd import (
    LANES,
    above,
    bits,
    constant,
    load,
    lowest_bit,
    minimum,
    negative_abs,
    pair_sums,
    prefetch,
    select,
    splat,
    store,
    stream,
)
from ..vectors.vector_math import exp2_alpha
from .bins import CELLS, SLACK, cells_reached
from .record import (
    ALPHA_MAX,
    BLOCK,
    CHANNEL,
    CHANNELS,
    LOG2_ALPHA_MIN,
    ROW,
    SLOPE,
    TILE,
    TOP,
    TRANSMITTANCE_MIN,
    A,
    K,
    Q,
    X,
    Y,
)

ZERO, HALF, ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
SIDE = TILE // BLOCK  # 4, or 2 for tiles of 8 pixels
PIXELS = TILE * TILE
BLOCKS = PIXELS // LANES
COLOR = CHANNELS * PIXELS
EVERY_LANE = 0xFFFF
NEVER = np.int32(2**31 - 1)
LANE_X = constant([lane % BLOCK for lane in range(LANES)])
LANE_Y = constant([lane // BLOCK for lane in range(LANES)])
BATCH = 16  # list entries whose reach is found together
AHEAD = 8  # list entries whose records are asked for ahead of their use


@inline
def _start_tile(trans, color, last, tile, x0, y0, width, height):
    """Empty state; pixels outside the image have stopped."""
    for pixel in range(PIXELS):
        block, lane = pixel // LANES, pixel % LANES
        x = x0 + block % SIDE * BLOCK + lane % BLOCK
        y = y0 + block // SIDE * BLOCK + lane // BLOCK
        inside = x < width and y < height
        trans[tile * PIXELS + pixel] = ONE if inside else -ONE
        # or nothing would stop the backward pass there: transmittance overflows, and the lanes of a block are summed
        last[tile * PIXELS + pixel] = NEVER if inside else np.int32(0)
    for pixel in range(COLOR):
        color[tile * COLOR + pixel] = ZERO


@kernel
def forward(
    begin, end, rows, members, starts, ends, base, width, height, tiles_x, trans, color, last, reached, finished
):
    """Composite tiles begin..end-1 behind their content; behind nothing if base, the number of earlier entries, is 0.

    Reads the flat rows [N * ROW] and lists members[starts[tile] : ends[tile]]. Changes the tile state; ends becomes
    one past the last entry that was looked at, reached [I] uint16 the bits of the blocks to which an entry
    contributed, and finished marks tiles all of whose pixels have stopped.
    """
    stopped = np.empty(BLOCKS, np.int64)
    for tile in range(begin, end):
        x0, y0 = tile % tiles_x * TILE, tile // tiles_x * TILE
        if base == 0:
            _start_tile(trans, color, last, tile, x0, y0, width, height)
        elif finished[tile]:
            ends[tile] = starts[tile]
            continue
        alive = 0
        for block in range(BLOCKS):
            stopped[block] = bits(load(trans, tile * PIXELS + block * LANES) < ZERO)
            if stopped[block] != EVERY_LANE:
                alive |= 1 << block
        ends[tile] = _forward_tile(
            rows, members, starts[tile], ends[tile], base, np.float32(x0), np.float32(y0), tile, alive, stopped, trans,
            color, last, reached,
        )  # fmt: skip
        finished[tile] = True
        for block in range(BLOCKS):
            if stopped[block] != EVERY_LANE:
                finished[tile] = False


@inline
def _record(rows, p, x0, y0):
    return rows[p + X] - x0, rows[p + Y] - y0, rows[p + A], rows[p + K], rows[p + Q], rows[p + TOP]


@inline
def _forward_tile(
    rows, members, start, end, base, x0, y0, tile, alive, stopped, trans, color, last, reached
):  # fmt: skip
    lane_x, lane_y = LANE_X(), LANE_Y()
    for place in range(start, end):
        if (place - start) % BATCH == 0:
            _reach_ahead(rows, members, place, min(place + BATCH, end), x0, y0, reached)
        if not alive:
            return place
        p = np.int64(members[place]) * ROW
        x, y, a, k, q, top = _record(rows, p, x0, y0)
        todo = np.int64(reached[place]) & alive
        sheared = lane_x + lane_y * k
        c0, c1, c2, c3 = rows[p + CHANNEL], rows[p + CHANNEL + 1], rows[p + CHANNEL + 2], rows[p + CHANNEL + 3]
        contributed = 0
        while todo:
            block = lowest_bit(todo)
            todo &= todo - 1
            at, at_color = tile * PIXELS + block * LANES, tile * COLOR + block * LANES
            block_y = np.float32(block // SIDE * BLOCK) + HALF - y
            u = sheared + (np.float32(block % SIDE * BLOCK) + HALF - x + k * block_y)
            dy = lane_y + block_y
            power = top - q * dy * dy - a * u * u
            counts = power >= LOG2_ALPHA_MIN
            alpha = select(counts, minimum(exp2_alpha(power), ALPHA_MAX), ZERO)
            before = load(trans, at)
            weight = alpha * before
            after = before - weight
            stop = after < TRANSMITTANCE_MIN
            weight = select(stop, ZERO, weight)
            store(trans, at, select(stop, negative_abs(before), after))
            store(color, at_color, load(color, at_color) + weight * c0)
            store(color, at_color + PIXELS, load(color, at_color + PIXELS) + weight * c1)
            store(color, at_color + 2 * PIXELS, load(color, at_color + 2 * PIXELS) + weight * c2)
            store(color, at_color + 3 * PIXELS, load(color, at_color + 3 * PIXELS) + weight * c3)
            stop_bits = bits(stop)
            contributed |= np.int64(bits(counts) & ~stop_bits != 0) << block
            if stop_bits != stopped[block]:
                new = stop_bits & ~stopped[block]
                stopped[block] = stop_bits
                while new:
                    last[at + lowest_bit(new)] = base + place
                    new &= new - 1
                if stop_bits == EVERY_LANE:
                    alive &= ~(1 << block)
        reached[place] = contributed
    return end


@inline
def _reach_ahead(rows, members, start, end, x0, y0, reached):
    """Which blocks the next entries reach. In a loop of their own, their latency hides behind each other."""
    for place in range(start, end):
        prefetch(rows, np.int64(members[min(place + BATCH, len(members) - 1)]) * ROW)
        p = np.int64(members[place]) * ROW
        x, y, a, k, q, top = _record(rows, p, x0, y0)
        limit = top - LOG2_ALPHA_MIN + SLACK
        cells = cells_reached(x, y, a, k, q, rows[p + SLOPE], limit, np.float32(BLOCK))
        reached[place] = cells if SIDE == CELLS else (cells & 3) | (cells >> 2 & 12)


@kernel
def to_image(begin, end, trans, color, width, tiles_x, first_channel, image, alpha):
    """Copy image rows begin..end-1 out of the tiles: channels first_channel.. of image [H, W, D], and alpha [H, W]."""
    n = min(CHANNELS, image.shape[2] - first_channel)
    for y in range(begin, end):
        for x in range(0, width, BLOCK):
            tile, row = y // TILE * tiles_x + x // TILE, _block_row(x % TILE, y % TILE)
            at, at_color = tile * PIXELS + row, tile * COLOR + row
            for i in range(min(BLOCK, width - x)):
                alpha[y, x + i] = ONE - abs(trans[at + i])
                for channel in range(n):
                    image[y, x + i, first_channel + channel] = color[at_color + channel * PIXELS + i]


@inline
def _block_row(x, y):
    """Where in a tile the four pixels of a block's row begin, of which (x, y) is the first."""
    return (y // BLOCK * SIDE + x // BLOCK) * LANES + y % BLOCK * BLOCK


@kernel
def from_image(begin, end, trans, width, height, tiles_x, first_channel, v_image, v_alpha, left, behind, v_color):
    """Set up the backward state of tiles begin..end-1 from the gradients of image [H, W, D] and alpha [H, W].

    left is the transmittance behind all Gaussians; behind the gradient-weighted light from there, as if the background
    were one more Gaussian; v_color the channels' gradients. Alpha's gradient counts with channel 0 alone.
    """
    n = min(CHANNELS, v_image.shape[2] - first_channel)
    for tile in range(begin, end):
        x0, y0 = tile % tiles_x * TILE, tile // tiles_x * TILE
        v_color[tile * COLOR : (tile + 1) * COLOR] = ZERO
        behind[tile * PIXELS : (tile + 1) * PIXELS] = ZERO
        for pixel in range(tile * PIXELS, (tile + 1) * PIXELS):
            left[pixel] = abs(trans[pixel])
        for y in range(y0, min(y0 + TILE, height)):
            for x in range(x0, min(x0 + TILE, width), BLOCK):
                row = _block_row(x - x0, y - y0)
                at, at_color = tile * PIXELS + row, tile * COLOR + row
                for i in range(min(BLOCK, width - x)):
                    if first_channel == 0:
                        behind[at + i] = -v_alpha[y, x + i] * left[at + i]
                    for channel in range(n):
                        v_color[at_color + channel * PIXELS + i] = v_image[y, x + i, first_channel + channel]


@kernel
def backward(
    begin, end, rows, members, within, slots, reached, starts, ends, list_ends, base, first_row, tiles_x, left, behind,
    v_color, last, v_rows,
):  # fmt: skip
    """Walk the lists of tiles begin..end-1 back to front; one gradient row of v_rows [rows, ROW] per entry.

    An entry's row is first_row + slots[its Gaussian] + within[its place], so that a Gaussian's rows lie together.
    `left` and `behind` are the state behind the list, and afterwards the state in front of it; list_ends is where the
    lists end that `ends` stopped looking at (those rows become zero).
    """
    zero = splat(ZERO)
    for tile in range(begin, end):
        for place in range(ends[tile], list_ends[tile]):
            stream(v_rows, (first_row + slots[members[place]] + within[place]) * ROW, zero)
        x0, y0 = np.float32(tile % tiles_x * TILE), np.float32(tile // tiles_x * TILE)
        for place in range(ends[tile] - 1, starts[tile] - 1, -1):
            prefetch(rows, np.int64(members[max(place - AHEAD, starts[tile])]) * ROW)
            out = (first_row + slots[members[place]] + within[place]) * ROW
            if reached[place] == 0:
                stream(v_rows, out, zero)
                continue
            _backward_entry(
                rows, np.int64(members[place]) * ROW, base + place, np.int64(reached[place]), x0, y0, tile, left,
                behind, v_color, last, out, v_rows,
            )  # fmt: skip


@inline
def _backward_entry(rows, p, place, todo, x0, y0, tile, left, behind, v_color, last, out, v_rows):
    lane_x, lane_y = LANE_X(), LANE_Y()
    x, y, a, k, q, top = _record(rows, p, x0, y0)
    sheared = lane_x + lane_y * k
    c0, c1, c2, c3 = rows[p + CHANNEL], rows[p + CHANNEL + 1], rows[p + CHANNEL + 2], rows[p + CHANNEL + 3]
    s = splat(ZERO)
    su, suu, suy, sy, syy, v0, v1, v2, v3 = s, s, s, s, s, s, s, s, s
    while todo:
        block = lowest_bit(todo)
        todo &= todo - 1
        at, at_color = tile * PIXELS + block * LANES, tile * COLOR + block * LANES
        block_y = np.float32(block // SIDE * BLOCK) + HALF - y
        u = sheared + (np.float32(block % SIDE * BLOCK) + HALF - x + k * block_y)
        dy = lane_y + block_y
        power = top - q * dy * dy - a * u * u
        uncapped = exp2_alpha(power)
        counts = (power >= LOG2_ALPHA_MIN) & above(last, at, place)
        alpha = select(counts, minimum(uncapped, ALPHA_MAX), ZERO)
        inverse = ONE / (ONE - alpha)
        before = load(left, at) * inverse
        store(left, at, before)
        weight = alpha * before
        g0, g1 = load(v_color, at_color), load(v_color, at_color + PIXELS)
        g2, g3 = load(v_color, at_color + 2 * PIXELS), load(v_color, at_color + 3 * PIXELS)
        light = g0 * c0 + g1 * c1 + g2 * c2 + g3 * c3
        back = load(behind, at)
        store(behind, at, back + weight * light)
        # a capped alpha has no slope
        g = select(uncapped <= ALPHA_MAX, alpha * (before * light - back * inverse), ZERO)
        gu, gy = g * u, g * dy
        s += g
        su += gu
        suu += gu * u
        suy += gu * dy
        sy += gy
        syy += gy * dy
        v0 += weight * g0
        v1 += weight * g1
        v2 += weight * g2
        v3 += weight * g3
    low = pair_sums(pair_sums(s, su), pair_sums(suu, suy))
    high = pair_sums(pair_sums(sy, syy), pair_sums(v0, v1))
    rest = pair_sums(v2, v3)
    rest = pair_sums(rest, rest)
    stream(v_rows, out, pair_sums(pair_sums(low, high), pair_sums(rest, rest)))
