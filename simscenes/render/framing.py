"""Cameras for scenes that come with one sensor: that sensor as a rig, and a rig fitted around what it sees."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.backend import backend_of, using_variant
from simscenes.loading.load import LoadedScene, build_in_fewest_colors
from simscenes.loading.reference import SceneLike, SceneRef
from simscenes.optics import Optics
from simscenes.render.geometry import pixel_rays, shrunk
from simscenes.rigs import Rig, invert_rigid, look_at, mitsuba_to_intrinsics, mitsuba_to_opencv, there_and_back
from simscenes.scenes import default_rig

Float = NDArray[np.float64]
WHY_NOT = {  # of the sensors that have no pinhole camera's rays
    "OrthographicCamera": " (its rays are parallel, those of our cameras meet in a point)",
    "DistantSensorImpl": " (it measures light that leaves the scene, and takes no picture)",
    "IrradianceMeter": " (it measures light on a surface, and takes no picture)",
    "RadianceMeter": " (it measures a single ray, and takes no picture)",
    "BatchSensor": " (name the sensors within it one by one)",
}
MAX_PIXELS = 1 << 26  # an untrusted file must not ask for all memory
CLEARANCE = 0.05  # of the distance to the target: nearer things would fill a new camera's image


def own_rig(loaded: LoadedScene, mi: Any, width: int | None = None, height: int | None = None) -> Rig:
    """The scene's own sensor as a rig of one view.

    Args:
        loaded: The scene.
        mi: The mitsuba module.
        width: Image width in pixels; None for the sensor's film. The horizontal field of view is kept.
        height: Image height in pixels; None for the sensor's film.

    Raises:
        ValueError: If the scene has no sensor, or not a perspective one.
    """
    sensor, seen = loaded.own_sensor, "none" if loaded.own_sensor is None else loaded.own_sensor.class_name()
    if seen not in ("PerspectiveCamera", "ThinLensCamera"):
        why = WHY_NOT.get(seen, "")
        raise ValueError(f"scene {loaded.name!r} needs a perspective or thinlens sensor to find cameras by, it has "
                         f"{seen}{why}; add one, or give the rig")  # fmt: skip
    film = sensor.film()
    crop_width, crop_height = (int(n) for n in film.crop_size())
    w, h = width or crop_width, height or crop_height
    if w * h > MAX_PIXELS:
        raise ValueError(f"scene {loaded.name!r} asks for a film of {w} x {h} pixels, more than {MAX_PIXELS >> 20} Mi; "
                         "give width and height")  # fmt: skip
    K = _film_intrinsics(mi.traverse(sensor), film)
    K[0] *= w / crop_width  # the field of view is kept across, pixels stay square, the centre keeps its relative place
    K[1, 1], K[1, 2] = K[0, 0], K[1, 2] * h / crop_height
    to_world = np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4, -1)[..., 0]
    to_world[:3, :3] /= np.linalg.norm(to_world[:3, :3], axis=0)  # some exporters leave a scale in the pose
    return Rig(viewmats=mitsuba_to_opencv(to_world)[None], Ks=K[None], width=w, height=h)


def own_cameras(
    scene: SceneLike | SceneRef | LoadedScene,
    width: int | None = None,
    height: int | None = None,
    *,
    allow_outside: bool = False,
) -> Rig:
    """All of a scene's own sensors as a rig, in the order of the scene.

    Args:
        scene: As for `fit_rig`.
        width: As for `own_rig`.
        height: As for `own_rig`.
        allow_outside: As for `render_set`.

    Raises:
        ValueError: As `own_rig`, or if the films differ in size where it is not given.
    """
    loaded = _loaded(scene, allow_outside)
    with using_variant(loaded.variant) as mi:
        count = len(loaded.scene.sensors())
        rigs = [own_rig(replace(loaded, sensor=k), mi, width, height) for k in range(max(count, 1))]
    sizes = sorted({(rig.width, rig.height) for rig in rigs})
    if len(sizes) > 1:
        raise ValueError(f"scene {loaded.name!r} has sensors of {len(sizes)} sizes, {sizes[0]} to {sizes[-1]}: one set "
                         "has pictures of one size; give width and height")  # fmt: skip
    viewmats, Ks = (np.concatenate([getattr(rig, name) for rig in rigs]) for name in ("viewmats", "Ks"))
    return Rig(viewmats=viewmats, Ks=Ks, width=rigs[0].width, height=rigs[0].height)


def with_lens(asked: Optics | None, loaded: LoadedScene, mi: Any) -> Optics:
    """The requested optics, with the lens of the scene's own sensor where none is given; a pinhole has none.

    A thin lens keeps its focus distance for all cameras of a rig: those of `fit_rig` stay as far from what they see.
    """
    asked = asked or Optics()
    sensor = loaded.own_sensor
    if asked.aperture_radius == 0:
        return replace(asked, aperture_radius=None)
    if asked.aperture_radius is not None or sensor is None or sensor.class_name() != "ThinLensCamera":
        return asked
    lens = mi.traverse(sensor)
    radius, focus = (float(np.array(lens[key]).item()) for key in ("aperture_radius", "focus_distance"))
    return replace(asked, aperture_radius=radius, focus_distance=focus)


def _film_intrinsics(params: Any, film: Any) -> Float:
    """Intrinsics [3,3] of a sensor in pixels of its crop; Mitsuba's angle and offsets belong to the whole film."""

    def number(key: str) -> float:
        return float(np.array(params[key]).ravel()[0]) if key in params.keys() else 0.0  # noqa: SIM118

    ppx, ppy = number("principal_point_offset_x"), number("principal_point_offset_y")
    K = mitsuba_to_intrinsics(number("x_fov"), ppx, ppy, *(int(n) for n in film.size()))
    K[:2, 2] -= np.array(film.crop_offset(), dtype=np.float64).ravel()
    return K


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
    """Cameras on an arc around what a scene's own sensor sees, in the space that is free around it.

    The target is the median point the sensor sees near its centre; the arc turns about the sensor's own up axis. If a
    camera would end up behind or within a surface, the whole arc is narrowed until none does.

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
    loaded = _loaded(scene, allow_outside)
    with using_variant(loaded.variant) as mi:
        return _arc_around(loaded, mi, own_rig(loaded, mi, width, height), n_views, sweep_deg, swing_deg)


def _loaded(scene: SceneLike | SceneRef | LoadedScene, allow_outside: bool) -> LoadedScene:
    if isinstance(scene, LoadedScene):
        return scene
    return build_in_fewest_colors(scene, backend_of(), allow_outside=allow_outside)


def _arc_around(loaded: LoadedScene, mi: Any, own: Rig, n_views: int, sweep_deg: float, swing_deg: float) -> Rig:
    """As `fit_rig`, with the scene's own sensor as a rig of one view."""
    c2w = invert_rigid(own.viewmats[0])
    position, up = c2w[:3, 3], -c2w[:3, 1]
    distance = _distance_seen(loaded, mi, own)
    target = position + distance * c2w[:3, 2]
    for narrowing in 0.5 ** np.arange(8):
        positions = _arc(position, target, up, n_views, narrowing * sweep_deg, narrowing * swing_deg)
        if _are_free(loaded, mi, position, positions, CLEARANCE * distance):
            viewmats = np.stack([look_at(p, target, up) for p in positions])
            return Rig(viewmats=viewmats, Ks=np.repeat(own.Ks, n_views, 0), width=own.width, height=own.height)
    raise ValueError(f"scene {loaded.name!r}: no free space around its sensor at {position.round(3).tolist()}; "
                     "is it inside an object? Give the rig")  # fmt: skip


def usual_rig(source: SceneRef, loaded: LoadedScene, n_views: int, width: int, height: int) -> Rig:
    """Default cameras: a catalogue scene's own at this size, or an arc at the size of the scene's sensor.

    Raises:
        ValueError: As `fit_rig`.
    """
    return default_rig(source.name, n_views, width, height) if source.in_catalogue else fit_rig(loaded, n_views)


def _rays(loaded: LoadedScene, mi: Any, origins: Float, directions: Float) -> Float:
    """Distance to the first surface along each ray, inf where there is none; [n]."""
    if mi.variant().startswith("scalar"):
        hits = [
            loaded.scene.ray_intersect_preliminary(mi.Ray3f(o, d))
            for o, d in zip(origins.tolist(), directions.tolist(), strict=True)
        ]
        return np.array([h.t if h.is_valid() else np.inf for h in hits], dtype=np.float64)
    ray = mi.Ray3f(mi.Point3f(np.float32(origins.T)), mi.Vector3f(np.float32(directions.T)))
    hit = loaded.scene.ray_intersect_preliminary(ray)
    return np.where(np.array(hit.is_valid()), np.array(hit.t, dtype=np.float64), np.inf)


def _distance_seen(loaded: LoadedScene, mi: Any, own: Rig) -> float:
    """Median distance along the middle third of the image."""
    origin, directions = pixel_rays(shrunk(own, 0, 48), 0)
    chosen = directions.reshape(48, 48, 3)[16:32, 16:32].reshape(-1, 3)
    distances = _rays(loaded, mi, np.broadcast_to(origin, chosen.shape), chosen)
    seen = distances[np.isfinite(distances)]
    if len(seen) == 0:
        raise ValueError(f"scene {loaded.name!r}: its sensor sees no surface; give the rig")
    return float(np.median(seen))


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
