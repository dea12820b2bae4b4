"""From Gaussians to one camera's image and back: the order in which the kernels run.

One pass forward and backward takes, and recycles, 360 bytes per Gaussian at SH degree 3 (of these 192 + 12 gradients of
colour, 44 of the shape, and its record of 64), 74 per (Gaussian, tile) pair (of these 64 of gradients), 64 per pixel.
Every four channels more than four take 80, 66 and 40 more.
"""

from dataclasses import dataclass

import numpy as np
import torch

from . import bins, composite, harmonics, plain_channels, project, project_backward, sort
from .memory import empty
from .parallel import run
from .record import CHANNELS, ROW, TILE

CHUNKS_PER_THREAD = 4
WAVE = 256  # list entries per tile of the first wave; saturated tiles take none of the next, which is twice as long
GRAIN_TILES = 2


@dataclass(frozen=True, kw_only=True)
class Camera:
    """One pinhole camera and what it renders."""

    viewmat: np.ndarray  # [4, 4] float32, world to camera
    K: np.ndarray  # [3, 3] float32
    width: int
    height: int
    near: float
    far: float
    eps2d: float  # px^2
    antialiased: bool = False  # compensate opacities for eps2d
    radius_clip: float = 0.0  # pixels; splats that reach no farther are left out

    @property
    def vector(self) -> np.ndarray:
        """As the projection kernels want it."""
        K = self.K
        rest = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], self.width, self.height, self.near, self.far, self.eps2d]
        rest += [self.antialiased, self.radius_clip]
        return np.concatenate([self.viewmat[:3].ravel(), np.array(rest, np.float32)]).astype(np.float32)

    @property
    def center(self) -> np.ndarray:
        """In the world [3]."""
        return np.ascontiguousarray(-self.viewmat[:3, :3].T @ self.viewmat[:3, 3])

    @property
    def tiles_x(self) -> int:
        """Tiles per image row."""
        return -(-self.width // TILE)

    @property
    def tiles_y(self) -> int:
        """Tiles per image column."""
        return -(-self.height // TILE)


@dataclass(frozen=True, kw_only=True)
class Shape:
    """The trained quantities that shape the splats, float32."""

    means: np.ndarray  # [N, 3]
    quats: np.ndarray  # [N, 4]
    scales: np.ndarray  # [N, 3]
    opacities: np.ndarray  # [N]


@dataclass(kw_only=True)
class Splats:
    """Projected Gaussians."""

    rows: np.ndarray  # [N, ROW]
    depths: np.ndarray  # [N]
    radii: np.ndarray  # [N] int32, 0: not visible
    tiles: np.ndarray  # [N] int32, at most so many tiles
    counts: np.ndarray  # [N] int32, entries in the tile lists
    suspect: bool  # some input is not finite or out of range


@dataclass(kw_only=True)
class Wave:
    """Tile lists of a range of depth ranks."""

    members: np.ndarray  # [I] int32: Gaussians, tile after tile
    within: np.ndarray  # [I] int32: number of the tile among the Gaussian's tiles
    starts: np.ndarray  # [tiles] int64
    list_ends: np.ndarray  # [tiles] int64
    ends: np.ndarray  # [tiles] int64: where compositing stopped looking
    base: int  # entries of the waves before


def project_forward(shape: Shape, camera: Camera) -> Splats:
    """Project all Gaussians; channels are left out."""
    n = len(shape.means)
    rows, depths, radii = empty((n, ROW)), empty(n), empty(n, np.int32)
    tiles, counts, suspect = empty(n, np.int32), empty(n, np.int32), np.zeros(1, np.int64)
    arrays = shape.means, shape.quats, shape.scales, shape.opacities
    run(project.forward, n, project.GRAIN, *arrays, camera.vector, rows, depths, radii, tiles, counts, suspect)
    return Splats(rows=rows, depths=depths, radii=radii, tiles=tiles, counts=counts, suspect=bool(suspect[0]))


def _n_chunks(n: int, grain: int) -> int:
    return max(1, min(CHUNKS_PER_THREAD * torch.get_num_threads(), n // grain))


def depth_order(splats: Splats) -> tuple[np.ndarray, int]:
    """Sort keys [V] uint64 of the visible Gaussians, nearest first, index in the low half; a bound of their tiles."""
    n = len(splats.radii)
    n_chunks = _n_chunks(n, sort.GRAIN)
    counts, n_tiles = np.empty(n_chunks, np.int64), np.empty(n_chunks, np.int64)
    low, high = np.empty(n_chunks, np.uint32), np.empty(n_chunks, np.uint32)
    run(
        sort.count_visible, n_chunks, 1, splats.radii, splats.tiles, n_chunks, splats.depths, counts, n_tiles, low, high
    )
    pairs = empty(int(counts.sum()), np.uint64)
    if len(pairs) == 0:
        return pairs, 0
    starts = np.cumsum(counts) - counts
    run(sort.fill_visible, n_chunks, 1, splats.radii, n_chunks, splats.depths, starts, low.min(), pairs)
    moved = empty(len(pairs), np.uint64)
    n_bits = int(high.max() - low.min()).bit_length()
    passes = -(-n_bits // sort.DIGIT)
    for i in range(passes):
        digit = -(-n_bits // passes)
        histogram = np.empty((n_chunks, 1 << digit), np.int64)
        shift = np.uint64(32 + i * digit)
        run(sort.count_digits, n_chunks, 1, pairs, n_chunks, shift, histogram)
        sort.exclusive_sums(histogram)
        run(sort.move_digits, n_chunks, 1, pairs, n_chunks, shift, histogram, moved)
        pairs, moved = moved, pairs
    return pairs, int(n_tiles.sum())


def _wave(
    splats: Splats, order: np.ndarray, first: int, n: int, base: int, camera: Camera, finished: np.ndarray
) -> Wave:
    """Lists of the Gaussians of depth rank first..first+n-1, for the tiles that are not finished."""
    n_chunks = _n_chunks(n, 1024)
    histogram, open_tiles = empty((n_chunks, len(finished)), np.int64), empty(len(finished), np.int64)
    run(bins.find_open, camera.tiles_y, 16, finished, camera.tiles_x, camera.tiles_y, open_tiles)
    codes, none = empty(n, np.int64), np.empty(0, np.int32)
    common = splats.rows, order, first, n_chunks, n, camera.tiles_x, camera.tiles_y, open_tiles, codes
    run(bins.first_grids, n_chunks, 1, *common)
    run(bins.visit, n_chunks, 1, False, *common, histogram, none, none, splats.counts)
    total = sort.exclusive_sums(histogram)
    if base + total >= 2**31:
        raise ValueError(
            f"the image must have fewer than 2^31 (Gaussian, tile) pairs, got {base + total}: make either smaller"
        )
    starts = histogram[0].copy()
    members, within = empty(total, np.int32), empty(total, np.int32)
    run(bins.visit, n_chunks, 1, True, *common, histogram, members, within, splats.counts)
    list_ends = np.append(starts[1:], total)
    return Wave(members=members, within=within, starts=starts, list_ends=list_ends, ends=list_ends.copy(), base=base)


@dataclass(kw_only=True)
class TileState:
    """What compositing four channels leaves in every tile; see `composite`."""

    trans: np.ndarray
    color: np.ndarray
    last: np.ndarray
    reached: list[np.ndarray]  # per wave


@dataclass(kw_only=True)
class Frame:
    """One rendered camera: what the backward pass needs."""

    camera: Camera
    splats: Splats
    waves: list[Wave]
    passes: list[tuple[np.ndarray, TileState]]  # records [N, ROW] and tiles, four channels each
    sh_degree: int | None
    n_features: int
    depth_channel: int  # -1: no depth


def _rows(sh: np.ndarray) -> np.ndarray:
    """[N, K, 3] as [N, 3 K]."""
    return sh.reshape(len(sh), 3 * sh.shape[1])  # said in full: numpy cannot tell what -1 is for no Gaussians


def _channel_rows(frame: Frame, shape: Shape, colors: np.ndarray) -> tuple[list[np.ndarray], bool]:
    """The records with colours and depth written in, one copy per four channels; and whether a colour is not finite."""
    splats, n, with_depth = frame.splats, len(shape.means), frame.depth_channel >= 0
    suspect = np.zeros(1, np.int64)
    if frame.sh_degree is not None and frame.n_features:
        run(
            harmonics.forward, n, project.GRAIN, frame.sh_degree, shape.means, _rows(colors),
            frame.camera.center, splats.depths, np.float32(with_depth), splats.radii, splats.rows, suspect,
        )  # fmt: skip
        return [splats.rows], bool(suspect[0])
    copies = []
    for first in range(0, frame.n_features + with_depth, CHANNELS):
        rows = splats.rows
        if first > 0:
            rows = empty(rows.shape)
            rows[:] = splats.rows
        numbers = first, frame.depth_channel
        run(plain_channels.fill, n, project.GRAIN, colors, splats.depths, *numbers, splats.radii, rows, suspect)
        copies.append(rows)
    return copies, bool(suspect[0])


def _new_state(n_tiles: int) -> TileState:
    pixels, colors = n_tiles * composite.PIXELS, n_tiles * composite.COLOR
    return TileState(trans=empty(pixels), color=empty(colors), last=empty(pixels, np.int32), reached=[])


def _composite(
    camera: Camera, rows: np.ndarray, wave: Wave, ends: np.ndarray, state: TileState, finished: np.ndarray
) -> None:
    state.reached.append(empty(len(wave.members), np.uint16))
    run(
        composite.forward, len(finished), GRAIN_TILES, rows.reshape(-1), wave.members, wave.starts, ends, wave.base,
        camera.width, camera.height, camera.tiles_x, state.trans, state.color, state.last,
        state.reached[-1], finished,
    )  # fmt: skip


def _first_pass(frame: Frame, rows: np.ndarray) -> TileState:
    """Make the lists and composite four channels, wave by wave: tiles that have finished get no more entries."""
    camera = frame.camera
    order, tile_bound = depth_order(frame.splats)
    n_tiles = camera.tiles_x * camera.tiles_y
    state, finished = _new_state(n_tiles), np.zeros(n_tiles, np.bool_)
    length = max(1024, len(order) * WAVE * n_tiles // max(tile_bound, 1))
    first = 0
    while first < len(order) and not finished.all() or not frame.waves:
        left = len(order) - first
        n = left if left < 2 * length else length
        base = sum(len(wave.members) for wave in frame.waves)
        wave = _wave(frame.splats, order, first, n, base, camera, finished)
        _composite(camera, rows, wave, wave.ends, state, finished)
        frame.waves.append(wave)
        first, length = first + n, 2 * length
    return state


def forward(
    shape: Shape, colors: np.ndarray, camera: Camera, sh_degree: int | None, with_color: bool, with_depth: bool
) -> tuple[Frame, np.ndarray, np.ndarray]:
    """Render one camera.

    Args:
        shape: Gaussians.
        colors: [N, D], or [N, K, 3] with an SH degree.
        camera: Where from.
        sh_degree: None for plain colours.
        with_color: Render the colours.
        with_depth: Render accumulated depth, as the last channel.

    Returns:
        State for `backward`, image [H, W, channels] and alpha [H, W]. Check `frame.splats.suspect` first: if it is
        set, the input may hold bad numbers and the image means nothing.
    """
    splats = project_forward(shape, camera)
    n_features = 0 if not with_color else colors.shape[-1]
    frame = Frame(
        camera=camera, splats=splats, waves=[], passes=[], sh_degree=sh_degree, n_features=n_features,
        depth_channel=n_features if with_depth else -1,
    )  # fmt: skip
    plain = colors if with_color else np.empty((len(colors), 0), np.float32)
    copies, bad_colors = _channel_rows(frame, shape, plain)
    splats.suspect |= bad_colors
    image, alpha = empty((camera.height, camera.width, n_features + with_depth)), empty((camera.height, camera.width))
    if splats.suspect:
        return frame, image, alpha
    for i, rows in enumerate(copies):
        if i == 0:
            state = _first_pass(frame, rows)
        else:
            state, finished = (
                _new_state(camera.tiles_x * camera.tiles_y),
                np.zeros(camera.tiles_x * camera.tiles_y, np.bool_),
            )
            for wave in frame.waves:
                _composite(camera, rows, wave, wave.list_ends.copy(), state, finished)
        arrays = state.trans, state.color, camera.width, camera.tiles_x, i * CHANNELS, image, alpha
        run(composite.to_image, camera.height, TILE, *arrays)
        frame.passes.append((rows, state))
    return frame, image, alpha


@dataclass(kw_only=True)
class Gradients:
    """Of the inputs of `forward`."""

    shape: Shape
    colors: np.ndarray
    viewmat: np.ndarray  # [4, 4]


def _composite_backward(frame: Frame, slots: np.ndarray, v_image: np.ndarray, v_alpha: np.ndarray) -> np.ndarray:
    """Gradient rows [passes * I, ROW] of all list entries, Gaussian i's at slots[i]..slots[i + 1]."""
    camera, n_entries = frame.camera, int(slots[-1])
    n_tiles = camera.tiles_x * camera.tiles_y
    v_rows = empty((len(frame.passes) * n_entries, ROW))
    left, behind = empty(n_tiles * composite.PIXELS), empty(n_tiles * composite.PIXELS)
    v_color = empty(n_tiles * composite.COLOR)
    for i, (rows, state) in enumerate(frame.passes):
        run(
            composite.from_image, n_tiles, GRAIN_TILES, state.trans, camera.width, camera.height, camera.tiles_x,
            i * CHANNELS, v_image, v_alpha, left, behind, v_color,
        )  # fmt: skip
        for wave, reached in reversed(list(zip(frame.waves, state.reached, strict=True))):
            run(
                composite.backward, n_tiles, GRAIN_TILES, rows.reshape(-1), wave.members, wave.within, slots, reached,
                wave.starts, wave.ends, wave.list_ends, wave.base, i * n_entries, camera.tiles_x, left, behind, v_color,
                state.last, v_rows.reshape(-1),
            )  # fmt: skip
    return v_rows


def backward(
    frame: Frame, shape: Shape, colors: np.ndarray, v_image: np.ndarray, v_alpha: np.ndarray, with_camera: bool
) -> Gradients:
    """Gradients from those of the image [H, W, channels] and alpha [H, W]; of the camera if asked for, else zero."""
    camera, splats, n = frame.camera, frame.splats, len(shape.means)
    slots = empty(n + 1, np.int64)
    slots[:n], slots[n] = splats.counts, 0
    sort.exclusive_sums(slots[None])  # numpy's cumsum would make a copy as int64
    v_rows = _composite_backward(frame, slots, v_image, v_alpha)
    v_shape = Shape(means=empty((n, 3)), quats=empty((n, 4)), scales=empty((n, 3)), opacities=empty(n))
    v_features = empty((n, frame.n_features))
    blocks = -(-n // project_backward.BLOCK)
    v_view = np.empty((blocks if with_camera else 0, project_backward.V_VIEW), np.float32)
    inputs = shape.means, shape.quats, shape.scales, shape.opacities, camera.vector
    outputs = v_shape.means, v_shape.quats, v_shape.scales, v_shape.opacities, v_features, v_view
    passes = len(frame.passes), frame.depth_channel
    run(project_backward.backward, blocks, 1, *inputs, v_rows.reshape(-1), slots, *passes, *outputs)
    v_viewmat = np.zeros((4, 4), np.float32)
    v_viewmat[:3] = v_view.sum(0, dtype=np.float64).reshape(3, 4)
    if frame.sh_degree is None or not frame.n_features:
        v_colors = v_features if frame.n_features else np.zeros_like(colors)
    else:
        v_colors = empty(colors.shape)
        v_center = np.empty((blocks if with_camera else 0, 3), np.float32)
        run(
            harmonics.backward, blocks, 1, project_backward.BLOCK, frame.sh_degree, shape.means, _rows(colors),
            camera.center, v_features, _rows(v_colors), v_shape.means, v_center,
        )  # fmt: skip
        total = v_center.sum(0, dtype=np.float64)  # centre = -R^T t
        v_viewmat[:3, 3] -= camera.viewmat[:3, :3] @ total
        v_viewmat[:3, :3] -= np.outer(camera.viewmat[:3, 3], total)
    return Gradients(shape=v_shape, colors=v_colors, viewmat=v_viewmat)
