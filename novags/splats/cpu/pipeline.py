"""From Gaussians to one camera's image and back: the order in which the kernels run.

One pass forward and backward takes, and recycles, 360 bytes per Gaussian at SH degree 3 (of these 192 + 12 gradients of
colour, 44 of the shape, and its record of 64), 74 per (Gaussian, tile) pair (of these 64 of gradients), 64 per pixel.
Every four channels more than four take 80, 66 and 40 more.
"""

from dataclasses import dataclass

import numpy as np
import torch

from .chains import forward as forward_chains
from .chains import gradient as gradient_chains
from .chains.forward import BASE, BUFFER, FINISHED, NUMBERS, TOTAL, VISIBLE
from .chains.stages import PARTS_PER_THREAD
from .memory import carve, empty
from .parallel import run, run_chain
from .raster import composite, plain_channels, project, project_backward, sort
from .raster.record import CHANNELS, ROW, TILE

WAVE = 256  # list entries per tile of the first wave; saturated tiles take none of the next, which is twice as long
GRAIN_TILES = 2


@dataclass(frozen=True, kw_only=True)
class RasterCamera:
    """One pinhole camera and its output."""

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

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """As the chains want them."""
        return self.means, self.quats, self.scales, self.opacities


@dataclass(kw_only=True)
class Splats:
    """Projected Gaussians."""

    rows: np.ndarray  # [N, ROW]
    depths: np.ndarray  # [N]
    radii: np.ndarray  # [N] int32, 0: not visible
    tiles: np.ndarray  # [N] int32, at most so many tiles
    counts: np.ndarray  # [N] int32, entries in the tile lists
    suspect: bool  # some input is not finite or out of range

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """As the chains want them."""
        return self.rows, self.depths, self.radii, self.tiles, self.counts


@dataclass(kw_only=True)
class Wave:
    """Tile lists of a range of depth ranks."""

    members: np.ndarray  # [I] int32: Gaussians, tile after tile
    within: np.ndarray  # [I] int32: number of the tile among the Gaussian's tiles
    starts: np.ndarray  # [tiles] int64
    list_ends: np.ndarray  # [tiles] int64
    ends: np.ndarray  # [tiles] int64: where compositing stopped looking
    base: int  # entries of the waves before


@dataclass(kw_only=True)
class TileState:
    """The state of every tile after compositing four channels; see `composite`."""

    trans: np.ndarray
    color: np.ndarray
    last: np.ndarray
    reached: list[np.ndarray]  # per wave


@dataclass(kw_only=True)
class RasterFrame:
    """One rendered camera: the data that the backward pass needs."""

    camera: RasterCamera
    vector: np.ndarray  # of the camera
    center: np.ndarray
    splats: Splats
    waves: list[Wave]
    passes: list[tuple[np.ndarray, TileState]]  # records [N, ROW] and tiles, four channels each
    degree: int  # of the harmonics; -1: plain channels
    n_features: int
    depth_channel: int  # -1: no depth


def _rows(sh: np.ndarray) -> np.ndarray:
    """[N, K, 3] as [N, 3 K]."""
    return sh.reshape(len(sh), 3 * sh.shape[1])  # said in full: numpy cannot resolve -1 for no Gaussians


def _new_state(n_tiles: int) -> TileState:
    pixels, colors = n_tiles * composite.PIXELS, n_tiles * composite.COLOR
    trans, color, last = carve((pixels, np.float32), (colors, np.float32), (pixels, np.int32), empty=empty)
    return TileState(trans=trans, color=color, last=last, reached=[])


def forward(
    shape: Shape, colors: np.ndarray, camera: RasterCamera, sh_degree: int | None, with_color: bool, with_depth: bool
) -> tuple[RasterFrame, np.ndarray, np.ndarray]:
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
    n, n_features = len(shape.means), 0 if not with_color else colors.shape[-1]
    depths, radii, tiles, counts = carve((n, np.float32), (n, np.int32), (n, np.int32), (n, np.int32), empty=empty)
    splats = Splats(rows=empty((n, ROW)), depths=depths, radii=radii, tiles=tiles, counts=counts, suspect=False)
    frame = RasterFrame(
        camera=camera, vector=camera.vector, center=camera.center, splats=splats, waves=[], passes=[],
        degree=-1 if sh_degree is None or not with_color else sh_degree, n_features=n_features,
        depth_channel=n_features if with_depth else -1,
    )  # fmt: skip
    if frame.degree >= 0:
        features = _rows(colors)
    else:
        features = colors if with_color else np.empty((len(colors), 0), np.float32)
    image, alpha = empty((camera.height, camera.width, n_features + with_depth)), empty((camera.height, camera.width))
    _first_pass(frame, shape, features, image, alpha)
    for first in range(CHANNELS, n_features + with_depth, CHANNELS):
        if splats.suspect:
            break
        _further_pass(frame, features, first, image, alpha)
    return frame, image, alpha


def _lists(n_tiles: int) -> tuple[np.ndarray, ...]:
    """starts, list_ends and ends of a wave."""
    return tuple(np.empty((3, n_tiles), np.int64))


def _first_pass(frame: RasterFrame, shape: Shape, features: np.ndarray, image: np.ndarray, alpha: np.ndarray) -> None:
    """Project, and composite four channels wave by wave: tiles that have finished get no more entries."""
    camera, splats, n = frame.camera, frame.splats, len(shape.means)
    n_tiles = camera.tiles_x * camera.tiles_y
    parts = PARTS_PER_THREAD * torch.get_num_threads()
    buffers, codes, histogram, open_tiles = carve(
        ((2, n), np.uint64), (n, np.int64), (parts * max(1 << sort.DIGIT, n_tiles), np.int64), (n_tiles, np.int64),
        empty=empty,
    )  # fmt: skip
    finished, suspect, numbers = np.zeros(n_tiles, np.bool_), np.zeros(1, np.int64), np.zeros(NUMBERS, np.int64)
    lists = _lists(n_tiles)
    run_chain(
        forward_chains.project_and_list, n, shape.arrays, features, frame.vector, frame.center, frame.degree,
        frame.depth_channel, splats.arrays, suspect, buffers, histogram, WAVE,
        (open_tiles, codes, *lists, finished), numbers,
    )  # fmt: skip
    splats.suspect = bool(suspect[0])
    if splats.suspect:
        return
    order, state = buffers[numbers[BUFFER]][: numbers[VISIBLE]], _new_state(n_tiles)
    while not numbers[FINISHED]:
        wave, reached = _new_wave(lists, numbers)
        next_lists, following = _lists(n_tiles), np.zeros(NUMBERS, np.int64)
        run_chain(
            forward_chains.composite_wave, n, frame.vector, splats.arrays, order, histogram,
            (open_tiles, codes, *lists, finished), (open_tiles, codes, *next_lists, finished), wave.members,
            wave.within, reached, (state.trans, state.color, state.last), image, alpha, numbers, following,
        )  # fmt: skip
        frame.waves.append(wave)
        state.reached.append(reached)
        lists, numbers = next_lists, following
    frame.passes.append((splats.rows, state))


def _new_wave(lists: tuple[np.ndarray, ...], numbers: np.ndarray) -> tuple[Wave, np.ndarray]:
    """Room for the lists that were counted, and for the blocks that they reach."""
    base, total = int(numbers[BASE]), int(numbers[TOTAL])
    if base + total >= 2**31:
        raise ValueError(
            f"the image must have fewer than 2^31 (Gaussian, tile) pairs, got {base + total}: make either smaller"
        )
    members, within, reached = carve((total, np.int32), (total, np.int32), (total, np.uint16), empty=empty)
    starts, list_ends, ends = lists
    return Wave(members=members, within=within, starts=starts, list_ends=list_ends, ends=ends, base=base), reached


def _further_pass(frame: RasterFrame, features: np.ndarray, first: int, image: np.ndarray, alpha: np.ndarray) -> None:
    """Composite the plain channels from `first` on, with the lists that are there."""
    camera, splats, suspect = frame.camera, frame.splats, np.zeros(1, np.int64)
    rows = empty(splats.rows.shape)
    rows[:] = splats.rows
    channels = features, splats.depths, first, frame.depth_channel
    run(plain_channels.fill, len(rows), project.GRAIN, *channels, splats.radii, rows, suspect)
    splats.suspect = bool(suspect[0])
    n_tiles = camera.tiles_x * camera.tiles_y
    state, finished = _new_state(n_tiles), np.zeros(n_tiles, np.bool_)
    for wave in frame.waves:
        state.reached.append(empty(len(wave.members), np.uint16))
        run(
            composite.forward, n_tiles, GRAIN_TILES, rows.reshape(-1), wave.members, wave.starts, wave.list_ends.copy(),
            wave.base, camera.width, camera.height, camera.tiles_x, state.trans, state.color, state.last,
            state.reached[-1], finished,
        )  # fmt: skip
    arrays = state.trans, state.color, camera.width, camera.tiles_x, first, image, alpha
    run(composite.to_image, camera.height, TILE, *arrays)
    frame.passes.append((rows, state))


@dataclass(kw_only=True)
class Gradients:
    """Gradients of the inputs of `forward`."""

    shape: Shape
    colors: np.ndarray
    viewmat: np.ndarray  # [4, 4]


def composite_backward(frame: RasterFrame, v_image: np.ndarray, v_alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient rows [passes * I, ROW] of all list entries, and slots [N + 1]: i's are slots[i]..slots[i + 1] - 1."""
    camera, n = frame.camera, len(frame.splats.depths)
    n_tiles, n_entries = camera.tiles_x * camera.tiles_y, sum(len(wave.members) for wave in frame.waves)
    v_rows, slots = empty((len(frame.passes) * n_entries, ROW)), empty(n + 1, np.int64)
    pixels, colors = n_tiles * composite.PIXELS, n_tiles * composite.COLOR
    pixel_state = carve((pixels, np.float32), (pixels, np.float32), (colors, np.float32), empty=empty)
    for i, (rows, state) in enumerate(frame.passes):
        for number in range(len(frame.waves) - 1, -1, -1):
            wave = frame.waves[number]
            run_chain(
                gradient_chains.composite_backward, n, number == len(frame.waves) - 1, frame.vector,
                frame.splats.counts, rows, i * CHANNELS, i * n_entries, wave.base, v_image, v_alpha, slots,
                wave.members, wave.within, state.reached[number], (wave.starts, wave.ends), wave.list_ends,
                state.trans, state.last, pixel_state, v_rows.reshape(-1),
            )  # fmt: skip
    return v_rows, slots


def camera_sums(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Room for the partial sums that N Gaussians give to the gradient of the camera and of its centre."""
    blocks = -(-n // project_backward.BLOCK)
    return np.empty((blocks, project_backward.V_VIEW), np.float32), np.zeros((blocks, 3), np.float32)


def viewmat_gradient(camera: RasterCamera, v_view: np.ndarray, v_center: np.ndarray) -> np.ndarray:
    """Gradient of the viewmat [4, 4] from these sums."""
    v_viewmat = np.zeros((4, 4), np.float32)
    v_viewmat[:3] = v_view.sum(0, dtype=np.float64).reshape(3, 4)
    total = v_center.sum(0, dtype=np.float64)  # centre = -R^T t
    v_viewmat[:3, 3] -= camera.viewmat[:3, :3] @ total
    v_viewmat[:3, :3] -= np.outer(camera.viewmat[:3, 3], total)
    return v_viewmat


def backward(
    frame: RasterFrame, shape: Shape, colors: np.ndarray, v_image: np.ndarray, v_alpha: np.ndarray, with_camera: bool
) -> Gradients:
    """Gradients from the gradients of the image [H, W, channels] and alpha [H, W]; of the camera if asked for, else
    zero.
    """
    camera, n, has_harmonics = frame.camera, len(shape.means), frame.degree >= 0
    v_rows, slots = composite_backward(frame, v_image, v_alpha)
    v_shape = Shape(means=empty((n, 3)), quats=empty((n, 4)), scales=empty((n, 3)), opacities=empty(n))
    v_features = empty((n, frame.n_features))
    v_view, v_center = camera_sums(n if with_camera else 0)
    v_colors = empty(colors.shape) if has_harmonics else (v_features if frame.n_features else np.zeros_like(colors))
    run_chain(
        gradient_chains.project_and_color_backward, n, shape.arrays, _rows(colors) if has_harmonics else v_features,
        frame.vector, frame.center, frame.degree, len(frame.passes), frame.depth_channel, v_rows.reshape(-1), slots,
        v_shape.arrays, v_features, _rows(v_colors) if has_harmonics else v_features, v_view, v_center,
    )  # fmt: skip
    return Gradients(shape=v_shape, colors=v_colors, viewmat=viewmat_gradient(camera, v_view, v_center))
