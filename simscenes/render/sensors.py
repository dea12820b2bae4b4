"""Mitsuba sensors for the cameras of a rig."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.camera import camera_color
from simscenes.optics import Optics
from simscenes.render.source import LoadedScene
from simscenes.rigs import Rig, intrinsics_to_mitsuba, opencv_to_mitsuba

PINHOLE = Optics()
PILOT_SPP = 16
MAX_INTERFACES = 64


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
                             f"({ppx:.3g}, {ppy:.3g}) image sizes; centre it or use a pinhole")  # fmt: skip
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
        "near_clip": 1e-4 * loaded.extent,
        "far_clip": 1e2 * loaded.extent,
        "to_world": mi.ScalarTransform4f(opencv_to_mitsuba(rig.viewmats[i])),
        "sampler": {"type": "multijitter", "sample_count": PILOT_SPP},
        "film": film,
    }


def medium_at(mi: Any, loaded: LoadedScene, position: NDArray[np.float64]) -> Any:
    """The medium around a point, or None: a camera in fog has to be told so.

    Found from the first border of a medium along +z; other surfaces in between are passed through.
    """
    scene = loaded.scene
    borders = [s for s in scene.shapes() if s.is_medium_transition()]
    if not borders:
        return None
    ray = mi.Ray3f(mi.Point3f(*(float(v) for v in position)), mi.Vector3f(0, 0, 1))
    for _ in range(MAX_INTERFACES):
        si = scene.ray_intersect(ray)
        if not np.array(si.is_valid()).all():
            return None
        shape = si.shape if mi.variant().startswith("scalar") else si.shape[0]
        if shape.is_medium_transition():
            return shape.interior_medium() if np.array(si.n.z).item() > 0 else shape.exterior_medium()
        ray = si.spawn_ray(ray.d)
    return None
