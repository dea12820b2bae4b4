"""The chains of a forward pass: projection, colours, depth order and the lists of the first wave; then wave by wave."""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..raster import bins, composite, harmonics, plain_channels, project, sort
from ..raster.record import TILE
from .stages import alone, done, parts, shared, wait

# Numbers of a wave: its first depth rank, its Gaussians, the next wave's Gaussians, (Gaussian, tile) pairs in the waves
# before and in this one, whether the image is finished and the wave empty; and of the whole pass: visible Gaussians,
# which of two buffers their order is in, a bound of the pairs, the smallest bits of a depth and how many bits differ. A
# number is written once in a chain: a thread that comes late must find the same sizes as the others.
FIRST, COUNT, LENGTH, BASE, TOTAL, FINISHED, VISIBLE, BUFFER, BOUND, LOW, BITS = range(11)
NUMBERS = 11
GRAIN_TILES = 2
GRAIN_PART = 1024  # Gaussians in a part of a wave

_project, _harmonics, _plain = shared(project.forward), shared(harmonics.forward), shared(plain_channels.fill)
_count_visible, _fill_visible = shared(sort.count_visible), shared(sort.fill_visible)
_count_digits, _move_digits = shared(sort.count_digits), shared(sort.move_digits)
_find_open, _first_grids, _visit = shared(bins.find_open), shared(bins.first_grids), shared(bins.visit)
_composite, _to_image = shared(composite.forward), shared(composite.to_image)


@kernel
def project_and_list(
    control, threads, shape, colors, camera, center, degree, depth_channel, splats, suspect, buffers, histogram,
    wave_entries, lists, numbers,
):  # fmt: skip
    """Project and colour all Gaussians, sort them by depth, and count the lists of the first wave.

    Args:
        control: Of `stages`.
        threads: How many take part.
        shape: means, quats, scales, opacities.
        colors: [N, D], or [N, 3 K] with a degree.
        camera: As `project` wants it.
        center: Of the camera in the world [3].
        degree: Of the harmonics, or -1 for plain channels.
        depth_channel: Where depth goes, or -1.
        splats: rows, depths, radii, tiles, counts, all written.
        suspect: [1] int64, set for bad numbers; then nothing is listed.
        buffers: [2, N] uint64, one of them becomes the order: numbers[BUFFER].
        histogram: Flat int64, 4 threads times the larger of 2048 and the number of tiles.
        wave_entries: Entries per tile that the first wave should have.
        lists: As in `_count_wave`.
        numbers: [NUMBERS] int64, written.
    """
    rows, depths, radii, tiles, counts = splats
    n, grain = len(depths), project.GRAIN
    means, quats, scales, opacities = shape
    _project(
        control, 0, threads, n, grain, means, quats, scales, opacities, camera, rows, depths, radii, tiles, counts,
        suspect,
    )  # fmt: skip
    if degree >= 0:
        gain = np.float32(depth_channel >= 0)
        _harmonics(control, 1, threads, n, grain, degree, means, colors, center, depths, gain, radii, rows, suspect)
    else:
        _plain(control, 1, threads, n, grain, colors, depths, 0, depth_channel, radii, rows, suspect)
    if suspect[0]:
        return
    _depth_order(control, threads, depths, radii, tiles, buffers, histogram, numbers)
    if alone(control, 3):
        n_tiles, visible, bound = len(lists[0]), numbers[VISIBLE], numbers[BOUND]
        numbers[FIRST], numbers[BASE], numbers[FINISHED] = 0, 0, 0
        numbers[LENGTH] = max(1024, visible * wave_entries * n_tiles // max(bound, 1))
        _size_wave(numbers)
        done(control, 3)
    wait(control, 3, 1)
    order = buffers[numbers[BUFFER]][: numbers[VISIBLE]]
    _count_wave(control, 20, threads, rows, order, counts, camera, histogram, lists, numbers)


@inline
def _size_wave(numbers):
    """Set how many Gaussians the wave takes, a remainder shorter than the wave included; the next is twice as long."""
    left = numbers[VISIBLE] - numbers[FIRST]
    numbers[COUNT] = left if left < 2 * numbers[LENGTH] else numbers[LENGTH]
    numbers[LENGTH] *= 2


@inline
def _depth_order(control, threads, depths, radii, tiles, buffers, histogram, numbers):
    """Sort keys of the visible Gaussians, nearest first, index in the low half; numbers[BOUND] bounds their tiles."""
    n = len(depths)
    n_parts = parts(n, sort.GRAIN, threads)
    sums = histogram[: 4 * n_parts].reshape(4, n_parts)
    _count_visible(control, 4, threads, n_parts, 1, radii, tiles, n_parts, depths, sums[0], sums[1], sums[2], sums[3])
    if alone(control, 5):
        visible, bound = 0, 0
        low, high = sums[2, 0], sums[3, 0]
        for part in range(n_parts):
            count = sums[0, part]
            sums[0, part] = visible
            visible += count
            bound += sums[1, part]
            low, high = min(low, sums[2, part]), max(high, sums[3, part])
        n_bits = 0
        while visible and (high - low) >> n_bits:
            n_bits += 1
        passes = -(-n_bits // sort.DIGIT)
        numbers[VISIBLE], numbers[BOUND], numbers[LOW], numbers[BITS] = visible, bound, low, n_bits
        numbers[BUFFER] = passes & 1
        done(control, 5)
    wait(control, 5, 1)
    visible, n_bits = numbers[VISIBLE], numbers[BITS]
    pairs, moved = buffers[0][:visible], buffers[1][:visible]
    _fill_visible(control, 6, threads, n_parts, 1, radii, n_parts, depths, sums[0], np.uint32(numbers[LOW]), pairs)
    passes = -(-n_bits // sort.DIGIT)
    for i in range(passes):
        digit, shift = -(-n_bits // passes), np.uint64(32 + i * (-(-n_bits // passes)))
        digits = histogram[: n_parts << digit].reshape(n_parts, 1 << digit)
        _count_digits(control, 7 + 3 * i, threads, n_parts, 1, pairs, n_parts, shift, digits)
        if alone(control, 8 + 3 * i):
            sort.exclusive_sums(digits)
            done(control, 8 + 3 * i)
        wait(control, 8 + 3 * i, 1)
        _move_digits(control, 9 + 3 * i, threads, n_parts, 1, pairs, n_parts, shift, digits, moved)
        pairs, moved = moved, pairs


@inline
def _count_wave(control, stage, threads, rows, order, counts, camera, histogram, lists, numbers):
    """Count the lists of a wave, in stages `stage` to `stage` + 3.

    lists: open_tiles [tiles] int64, codes [N] int64, starts, list_ends, ends [tiles] int64, finished [tiles] bool;
    starts and both ends are written.
    """
    open_tiles, codes, starts, list_ends, ends, finished = lists
    tiles_x = -(-np.int64(camera[project.WIDTH]) // TILE)
    tiles_y = -(-np.int64(camera[project.HEIGHT]) // TILE)
    _find_open(control, stage, threads, tiles_y, 16, finished, tiles_x, tiles_y, open_tiles)
    first, n = numbers[FIRST], numbers[COUNT]
    n_parts = parts(n, GRAIN_PART, threads)
    places = histogram[: n_parts * len(finished)].reshape(n_parts, len(finished))
    _first_grids(
        control, stage + 1, threads, n_parts, 1, rows, order, first, n_parts, n, tiles_x, tiles_y, open_tiles, codes
    )
    none = codes[:0].view(np.int32)  # while counting no members are written
    _visit(
        control, stage + 2, threads, n_parts, 1, False, rows, order, first, n_parts, n, tiles_x, tiles_y, open_tiles,
        codes, places, none, none, counts,
    )  # fmt: skip
    if alone(control, stage + 3):
        numbers[TOTAL] = sort.exclusive_sums(places)
        for tile in range(len(finished)):
            starts[tile] = places[0, tile]
            end = places[0, tile + 1] if tile + 1 < len(finished) else numbers[TOTAL]
            list_ends[tile], ends[tile] = end, end
        done(control, stage + 3)
    wait(control, stage + 3, 1)


@kernel
def composite_wave(
    control, threads, camera, splats, order, histogram, lists, next_lists, members, within, reached, state, image,
    alpha, numbers, following,
):  # fmt: skip
    """Write the lists of a wave that was counted, composite them, and count the next or copy the image.

    Args:
        control: Of `stages`.
        threads: How many take part.
        camera: As `project` wants it.
        splats: rows, depths, radii, tiles, counts; counts is written.
        order: Of the visible Gaussians.
        histogram: As `_count_wave` has left it.
        lists: Of this wave.
        next_lists: Of the next one.
        members: [numbers[TOTAL]] int32, written.
        within: Likewise.
        reached: [numbers[TOTAL]] uint16, written.
        state: trans, color, last of `composite`.
        image: [H, W, D], of which the first four channels are written.
        alpha: [H, W].
        numbers: [NUMBERS] int64, of this wave.
        following: Numbers of the next wave, written.
    """
    rows, _, _, _, counts = splats
    open_tiles, codes, starts, _, ends, finished = lists
    trans, color, last = state
    width, height = np.int64(camera[project.WIDTH]), np.int64(camera[project.HEIGHT])
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    first, n = numbers[FIRST], numbers[COUNT]
    n_parts = parts(n, GRAIN_PART, threads)
    places = histogram[: n_parts * len(finished)].reshape(n_parts, len(finished))
    _visit(
        control, 0, threads, n_parts, 1, True, rows, order, first, n_parts, n, tiles_x, tiles_y, open_tiles, codes,
        places, members, within, counts,
    )  # fmt: skip
    _composite(
        control, 1, threads, len(finished), GRAIN_TILES, rows.reshape(-1), members, starts, ends, numbers[BASE], width,
        height, tiles_x, trans, color, last, reached, finished,
    )  # fmt: skip
    if alone(control, 2):
        following[:] = numbers
        following[FIRST], following[BASE] = first + n, numbers[BASE] + numbers[TOTAL]
        following[FINISHED] = following[FIRST] >= len(order) or finished.all()
        _size_wave(following)
        done(control, 2)
    wait(control, 2, 1)
    if following[FINISHED]:
        _to_image(control, 3, threads, height, TILE, trans, color, width, tiles_x, 0, image, alpha)
    else:
        _count_wave(control, 4, threads, rows, order, counts, camera, histogram, next_lists, following)
