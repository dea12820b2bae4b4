"""Mitsuba sensors for the cameras of a rig."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.camera import camera_color
from simscenes.loading.contents import media_in
from simscenes.loading.load import LoadedScene
from simscenes.optics import Optics
from simscenes.rigs import Rig, intrinsics_to_mitsuba, opencv_to_mitsuba

PINHOLE = Optics()
MAX_INTERFACES = 64
NEAR, FAR = 1e-9, 1e2  # clip planes, in extents: a ground of 20,000 units must not hide things in front of the camera


def sensor_dict(mi: Any, rig: Rig, i: int, loaded: LoadedScene, optics: Optics = PINHOLE) -> dict[str, Any]:
    """Mitsuba sensor of view `i`: box filter (others leak between pixels and are not repeatable), float32 film.

    Args:
        mi: The mitsuba module.
        rig: The cameras.
        i: Which one.
        loaded: The scene; its size sets the clip planes, its fog may surround the camera.
        optics: Lens and colour filters.
    """
    fov, ppx, ppy = intrinsics_to_mitsuba(rig.Ks[i], rig.width, rig.height)
    lens: dict[str, Any] = {"type": "perspective", "principal_point_offset_x": ppx, "principal_point_offset_y": ppy}
    if optics.aperture_radius is not None:
        if max(abs(ppx), abs(ppy)) > 1e-9:
            raise ValueError(f"Mitsuba's thin lens has its principal point in the image centre, got an offset of "
                             f"({ppx:.3g}, {ppy:.3g}) image sizes; centre it or set aperture_radius=0")  # fmt: skip
        lens = {"type": "thinlens", "aperture_radius": optics.aperture_radius, "focus_distance": optics.focus_distance}
    medium = medium_at(mi, loaded, rig.positions[i])
    if medium is not None:
        lens["medium"] = medium
    size = {"width": rig.width, "height": rig.height, "rfilter": {"type": "box"}, "component_format": "float32"}
    film = {"type": "hdrfilm", "pixel_format": "rgb", **size}
    if optics.camera is not None and "spectral" in mi.variant():
        film = camera_color(optics.camera).film(rig.width, rig.height)
    return {
        **lens,
        "fov": fov,
        "fov_axis": "x",
        "near_clip": NEAR * loaded.extent,
        "far_clip": max(FAR * loaded.extent, 2 * (_from_middle(loaded, rig.positions[i]) + loaded.extent)),
        "to_world": mi.ScalarTransform4f(opencv_to_mitsuba(rig.viewmats[i])),
        "sampler": {"type": "multijitter", "sample_count": 16},
        "film": film,
    }


def _from_middle(loaded: LoadedScene, position: NDArray[np.float64]) -> float:
    """Distance of a point from the middle of the scene's bounding box."""
    box = loaded.scene.bbox()
    return float(np.linalg.norm(position - (np.ravel(box.min) + np.ravel(box.max)) / 2))


def medium_at(mi: Any, loaded: LoadedScene, position: NDArray[np.float64]) -> Any:
    """The medium around a point, or None: Mitsuba has to know that a camera is in fog.

    The first boundary of a medium along +z tells. A ray that meets no boundary is followed by one towards the scene's
    own sensor; if that meets no boundary either, both places are in the medium of the sensor.
    """
    if not media_in(loaded.scene, mi):
        return None
    found, medium = _first_border(mi, loaded.scene, position, np.array([0.0, 0.0, 1.0]), np.inf)
    if found or loaded.own_sensor is None:
        return medium
    sensor = loaded.own_sensor
    way = np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4, -1)[:3, 3, 0] - position
    distance = float(np.linalg.norm(way))
    if distance > 0:
        found, medium = _first_border(mi, loaded.scene, position, way / distance, distance)
    return medium if found else sensor.get_medium()


def _first_border(
    mi: Any, scene: Any, position: NDArray[np.float64], direction: NDArray[np.float64], distance: float
) -> tuple[bool, Any]:
    """Whether a medium boundary lies on a path, and the medium on the near side of it; other surfaces are ignored."""
    ray = mi.Ray3f(mi.Point3f(*position.tolist()), mi.Vector3f(*direction.tolist()))
    for _ in range(MAX_INTERFACES):
        si = scene.ray_intersect(ray)
        reached = np.array(si.p, dtype=np.float64).ravel() - position
        if not np.array(si.is_valid()).all() or np.linalg.norm(reached) > distance:
            break
        shape = si.shape if mi.variant().startswith("scalar") else si.shape[0]
        if shape.is_medium_transition():
            leaves = float(np.dot(np.array(si.n, dtype=np.float64).ravel(), direction)) > 0
            return True, shape.interior_medium() if leaves else shape.exterior_medium()
        ray = si.spawn_ray(ray.d)
    return False, None
