"""Cameras for a scene that comes with one sensor: an arc around that sensor's target, in the free space.

Rays find the free space, not a bounding box. A new camera can be reached from the sensor in a straight line, keeps
clear of surfaces, and sees most of its target, which it would not from outside a room.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.backend import using_variant
from simscenes.loading.load import LoadedScene
from simscenes.loading.reference import SceneLike, SceneRef
from simscenes.render.framing import opened, own_rig
from simscenes.render.geometry import pixel_rays, shrunk
from simscenes.rigs import Rig, invert_rigid, look_at, there_and_back
from simscenes.scenes import default_rig

Float = NDArray[np.float64]
CLEARANCE = 0.05  # of the distance to the target: nearer things would fill a new camera's image
GRID = 48  # rays across the sensor's image that find its surfaces
SEEN = 0.8  # of the things near the sensor's centre that each camera must see, and of its image that the sensor sees
PROBE = 16  # rays across the image of a new camera that find its surfaces
BACKDROP = 2.0  # times the target's distance: farther things leave the image as the camera turns about the target
NARROWINGS = 0.8 ** np.arange(24)  # of the arc, until all of its cameras are free: down to 0.6 %


def fit_rig(
    scene: SceneLike | SceneRef | LoadedScene,
    n_views: int,
    width: int | None = None,
    height: int | None = None,
    *,
    sweep_deg: float = 50.0,
    swing_deg: float = 10.0,
    allow_outside: bool = False,
) -> Rig:
    """Cameras on an arc around the target of a scene's own sensor, in the free space around it.

    The target lies on the sensor's axis, as far away as the things near its centre; the arc turns about the sensor's
    own up axis. If a camera would end up behind or within a surface, or lose sight of the sensor's target (as it does
    where it leaves a room), the whole arc is narrowed until none does.

    Args:
        scene: As for `render_set`.
        n_views: Number of cameras.
        width: Image width in pixels; None for the sensor's film.
        height: Image height in pixels; None for the sensor's film.
        sweep_deg: Width of the arc.
        swing_deg: Amplitude of the wave in elevation.
        allow_outside: As for `render_set`.

    Raises:
        ValueError: If the scene has no usable sensor, or it sees nothing.
    """
    if n_views < 1:
        raise ValueError(f"n_views must be >= 1, got {n_views}")
    loaded = opened(scene, allow_outside)
    with using_variant(loaded.variant) as mi:
        return _arc_around(loaded, mi, own_rig(loaded, mi, width, height), n_views, sweep_deg, swing_deg)


def usual_rig(source: SceneRef, loaded: LoadedScene, n_views: int, width: int, height: int) -> Rig:
    """Default cameras: a catalogue scene's own at this size, or an arc at the size of the scene's sensor.

    Raises:
        ValueError: As `fit_rig`.
    """
    return default_rig(source.name, n_views, width, height) if source.in_catalogue else fit_rig(loaded, n_views)


def _arc_around(loaded: LoadedScene, mi: Any, own: Rig, n_views: int, sweep_deg: float, swing_deg: float) -> Rig:
    """As `fit_rig`, with the scene's own sensor as a rig of one view."""
    c2w = invert_rigid(own.viewmats[0])
    position, up = c2w[:3, 3], -c2w[:3, 1]
    seen = _seen(loaded, mi, own)
    distances = np.linalg.norm(seen - position, axis=1)
    distance = _middle_distance(distances)
    things = seen[distances < BACKDROP * distance]
    target = position + distance * c2w[:3, 2]
    for narrowing in NARROWINGS:
        positions = _arc(position, target, up, n_views, narrowing * sweep_deg, narrowing * swing_deg)
        viewmats = np.stack([look_at(p, target, up) for p in positions])
        rig = Rig(viewmats=viewmats, Ks=np.repeat(own.Ks, n_views, 0), width=own.width, height=own.height)
        if (
            _are_free(loaded, mi, position, positions, CLEARANCE * distance)
            and _see(loaded, mi, rig, things)
            and _share_space(loaded, mi, rig, own)
        ):
            return rig
    raise ValueError(f"scene {loaded.name!r}: no free space around its sensor at {position.round(3).tolist()}; "
                     "is it inside an object? Take another one (--sensor-index), or give a rig in Python")  # fmt: skip


def _rays(loaded: LoadedScene, mi: Any, origins: Float, directions: Float) -> Float:
    """Distance to the first surface along each ray, [n]; inf for rays that hit nothing."""
    if mi.variant().startswith("scalar"):
        hits = [
            loaded.scene.ray_intersect_preliminary(mi.Ray3f(o, d))
            for o, d in zip(origins.tolist(), directions.tolist(), strict=True)
        ]
        return np.array([h.t if h.is_valid() else np.inf for h in hits], dtype=np.float64)
    ray = mi.Ray3f(mi.Point3f(np.float32(origins.T)), mi.Vector3f(np.float32(directions.T)))
    hit = loaded.scene.ray_intersect_preliminary(ray)
    return np.where(np.array(hit.is_valid()), np.array(hit.t, dtype=np.float64), np.inf)


def _seen(loaded: LoadedScene, mi: Any, own: Rig) -> Float:
    """Surface points [n,3] in the middle third of the sensor's image, or in the whole image if the middle is empty."""
    origin, directions = pixel_rays(shrunk(own, 0, GRID), 0)
    distances = _rays(loaded, mi, np.broadcast_to(origin, directions.shape), directions)
    inner = np.zeros((GRID, GRID), dtype=bool)
    inner[GRID // 3 : -GRID // 3, GRID // 3 : -GRID // 3] = True
    for chosen in (inner.ravel(), np.ones(GRID**2, dtype=bool)):
        hit = chosen & np.isfinite(distances)
        if hit.any():
            return np.asarray(origin + distances[hit, None] * directions[hit])
    raise ValueError(f"scene {loaded.name!r}: its sensor sees no surface; take another one (--sensor-index), or give "
                     "the rig in Python")  # fmt: skip


def _middle_distance(distances: Float) -> float:
    """Median distance, weighted by squared disparity: the distance of things, not of the sky or the dome behind them.

    A plain median of a small thing before a far backdrop is the backdrop's distance, and cameras would circle that.
    """
    order = np.argsort(distances)
    weights = np.cumsum(distances[order] ** -2.0)
    return float(distances[order][np.searchsorted(weights, weights[-1] / 2)])


def _arc(position: Float, target: Float, up: Float, n_views: int, sweep_deg: float, swing_deg: float) -> Float:
    from scipy.spatial.transform import Rotation

    t = there_and_back(n_views) / (n_views - 1) - 0.5 if n_views > 1 else np.zeros(1)
    right = np.cross(target - position, up)
    right /= np.linalg.norm(right)
    raised = Rotation.from_rotvec(np.radians(swing_deg) * np.sin(4 * np.pi * t)[:, None] * right)
    turned = Rotation.from_rotvec(np.radians(sweep_deg) * t[:, None] * up)
    return np.asarray(target + (turned * raised).apply(position - target))


def _are_free(loaded: LoadedScene, mi: Any, start: Float, positions: Float, clearance: float) -> bool:
    """Whether each position can be reached from `start` in a straight line and keeps clear of surfaces."""
    offsets = positions - start
    lengths = np.linalg.norm(offsets, axis=1)
    moved = lengths > 0
    if moved.any():
        reach = _rays(loaded, mi, np.broadcast_to(start, offsets[moved].shape), offsets[moved] / lengths[moved, None])
        if (reach < lengths[moved]).any():
            return False
    grid = np.stack(np.meshgrid(*[[-1.0, 0, 1]] * 3), -1).reshape(-1, 3)
    around = grid[np.abs(grid).sum(1) > 0] / np.linalg.norm(grid[np.abs(grid).sum(1) > 0], axis=1, keepdims=True)
    origins = np.repeat(positions, len(around), 0)
    return bool((_rays(loaded, mi, origins, np.tile(around, (len(positions), 1))) > clearance).all())


def _see(loaded: LoadedScene, mi: Any, rig: Rig, points: Float) -> bool:
    """Whether each view shows most of these points: within its image, and not behind something."""
    pixels, depth = rig.project(points)
    inside = (depth > 0) & (pixels >= 0).all(-1) & (pixels < [rig.width, rig.height]).all(-1)
    if (inside.sum(1) < SEEN * len(points)).any():
        return False
    view, point = np.nonzero(inside)
    free = _line_of_sight(loaded, mi, rig.positions[view], points[point])
    return bool((np.bincount(view[free], minlength=len(rig)) >= SEEN * len(points)).all())


def _share_space(loaded: LoadedScene, mi: Any, rig: Rig, own: Rig) -> bool:
    """Whether most of each view's surfaces can be seen from the sensor's place, and little more of it is empty."""
    rays = [pixel_rays(shrunk(r, i, PROBE), 0) for r in (own, rig) for i in range(len(r))]
    origins = np.repeat([origin for origin, _ in rays], PROBE**2, 0)
    directions = np.concatenate([d for _, d in rays])
    distances = _rays(loaded, mi, origins, directions)
    hit = np.isfinite(distances)
    points = origins[hit] + distances[hit, None] * directions[hit]
    good = np.zeros(len(hit), dtype=bool)
    good[hit] = _line_of_sight(loaded, mi, np.broadcast_to(own.positions[0], points.shape), points)
    shown = good.reshape(-1, PROBE**2).mean(1)
    empty = (~hit).reshape(-1, PROBE**2).mean(1)
    return bool((shown[1:] + np.minimum(empty[1:], empty[0]) >= SEEN).all())


def _line_of_sight(loaded: LoadedScene, mi: Any, starts: Float, points: Float) -> NDArray[np.bool_]:
    """Whether nothing lies between each start and surface point, [n]."""
    way = points - starts
    lengths = np.linalg.norm(way, axis=1)
    # The points lie on surfaces: rays in float32 end a little before or behind them.
    return np.asarray(_rays(loaded, mi, starts, way / lengths[:, None]) > (1 - 1e-3) * lengths)
