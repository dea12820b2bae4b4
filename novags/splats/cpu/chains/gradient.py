"""The chains of a backward pass: the tile lists from the last wave to the first, then the Gaussians."""

# mypy: allow-untyped-defs

from ..compiler import inline, kernel
from ..raster import composite, harmonics, project, project_backward
from ..raster.record import TILE
from .stages import alone, done, shared, wait

GRAIN_TILES = 2

_from_image, _composite = shared(composite.from_image), shared(composite.backward)
_project, _harmonics = shared(project_backward.backward), shared(harmonics.backward)


@inline
def _make_slots(counts, slots):
    total = 0
    for i in range(len(counts)):
        slots[i] = total
        total += counts[i]
    slots[len(counts)] = total


@kernel
def composite_backward(
    control, threads, is_last, camera, counts, rows, first_channel, first_row, base, v_image, v_alpha, slots, members,
    within, reached, wave, list_ends, trans, last, state, v_rows,
):  # fmt: skip
    """Walk through the lists of one wave, for four channels.

    Args:
        control: Of `stages`.
        threads: How many take part.
        is_last: Whether it is the last wave, with which the walk begins.
        camera: As `project` wants it.
        counts: Entries of each Gaussian in the lists [N].
        rows: Records with these channels [N, ROW].
        first_channel: Of these four.
        first_row: Of these channels in v_rows.
        base: Entries in the waves before.
        v_image: Gradient of the image [H, W, D].
        v_alpha: Of alpha [H, W].
        slots: [N + 1] int64: where a Gaussian's gradient rows are; written with the first channels of the last wave.
        members: Of the wave, and so on.
        within: See `bins`.
        reached: See `composite`.
        wave: starts, ends [tiles].
        list_ends: [tiles].
        trans: See `composite`.
        last: Likewise.
        state: left, behind, v_color of `composite.from_image`.
        v_rows: Gradient rows, flat, written.
    """
    left, behind, v_color = state
    starts, ends = wave
    width, height = camera[project.WIDTH], camera[project.HEIGHT]
    tiles_x = -(-int(width) // TILE)
    if is_last:
        if first_channel == 0:
            if alone(control, 0):
                _make_slots(counts, slots)
                done(control, 0)
            wait(control, 0, 1)
        _from_image(
            control, 1, threads, len(starts), GRAIN_TILES, trans, int(width), int(height), tiles_x, first_channel,
            v_image, v_alpha, left, behind, v_color,
        )  # fmt: skip
    _composite(
        control, 2, threads, len(starts), GRAIN_TILES, rows.reshape(-1), members, within, slots, reached, starts, ends,
        list_ends, base, first_row, tiles_x, left, behind, v_color, last, v_rows,
    )  # fmt: skip


@kernel
def project_and_color_backward(
    control, threads, shape, colors, camera, center, degree, passes, depth_channel, v_rows, slots, v_shape, v_features,
    v_colors, v_view, v_center,
):  # fmt: skip
    """Gradients of the Gaussians from their gradient rows.

    Args:
        control: Of `stages`.
        threads: How many take part.
        shape: means, quats, scales, opacities.
        colors: [N, 3 K] with a degree.
        camera: As `project` wants it.
        center: Of the camera in the world [3].
        degree: Of the harmonics, or -1 for plain channels.
        passes: Of four channels.
        depth_channel: Where depth is, or -1.
        v_rows: Gradient rows, flat.
        slots: Where a Gaussian's rows are [N + 1].
        v_shape: Gradients of the shape, written.
        v_features: Of the channels [N, D], written.
        v_colors: Of the coefficients [N, 3 K], written with a degree.
        v_view: Partial sums of the camera's gradient, or empty.
        v_center: Likewise of its centre.
    """
    means, quats, scales, opacities = shape
    v_means, v_quats, v_scales, v_opacities = v_shape
    blocks = -(-len(means) // project_backward.BLOCK)
    _project(
        control, 0, threads, blocks, 1, means, quats, scales, opacities, camera, v_rows, slots, passes, depth_channel,
        v_means, v_quats, v_scales, v_opacities, v_features, v_view,
    )  # fmt: skip
    if degree >= 0:
        _harmonics(
            control, 1, threads, blocks, 1, project_backward.BLOCK, degree, means, colors, center, v_features,
            v_colors, v_means, v_center,
        )  # fmt: skip
