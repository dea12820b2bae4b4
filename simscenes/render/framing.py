"""The sensor that a scene comes with: as a rig of one view, and its lens."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.loading.load import LoadedScene
from simscenes.optics import Optics
from simscenes.rigs import Rig, mitsuba_to_intrinsics, mitsuba_to_opencv

Float = NDArray[np.float64]
MAX_PIXELS = 1 << 26  # an untrusted file must not ask for all memory


def own_rig(loaded: LoadedScene, mi: Any, width: int | None = None, height: int | None = None) -> Rig:
    """The scene's own (first) sensor as a rig of one view.

    Args:
        loaded: The scene.
        mi: The mitsuba module.
        width: Image width in pixels; None for the sensor's film. The horizontal field of view is kept.
        height: Image height in pixels; None for the sensor's film.

    Raises:
        ValueError: If the scene has no sensor, or not a perspective one.
    """
    sensors = loaded.scene.sensors()
    if not sensors or sensors[0].class_name() not in ("PerspectiveCamera", "ThinLensCamera"):
        found = sensors[0].class_name() if sensors else "none"
        raise ValueError(f"scene {loaded.name!r} needs a perspective or thinlens sensor to find cameras by, it has "
                         f"{found}; add one, or give the rig")  # fmt: skip
    film = sensors[0].film()
    crop_width, crop_height = (int(n) for n in film.crop_size())
    w, h = width or crop_width, height or crop_height
    if w * h > MAX_PIXELS:
        raise ValueError(f"scene {loaded.name!r} asks for a film of {w} x {h} pixels, more than {MAX_PIXELS >> 20} Mi; "
                         "give width and height")  # fmt: skip
    K = _film_intrinsics(mi.traverse(sensors[0]), film)
    K[0] *= w / crop_width  # the field of view is kept across, pixels stay square, the centre keeps its relative place
    K[1, 1], K[1, 2] = K[0, 0], K[1, 2] * h / crop_height
    to_world = np.array(sensors[0].world_transform().matrix, dtype=np.float64).reshape(4, 4, -1)[..., 0]
    to_world[:3, :3] /= np.linalg.norm(to_world[:3, :3], axis=0)  # some exporters leave a scale in the pose
    return Rig(viewmats=mitsuba_to_opencv(to_world)[None], Ks=K[None], width=w, height=h)


def with_lens(asked: Optics | None, loaded: LoadedScene, mi: Any) -> Optics:
    """The requested optics, with the lens of the scene's own (first) sensor where none is given; a pinhole has none.

    A thin lens keeps its focus distance for all cameras of a rig: those of `fit_rig` stay as far from what they see.
    """
    asked = asked or Optics()
    sensors = loaded.scene.sensors()
    if asked.aperture_radius == 0:
        return replace(asked, aperture_radius=None)
    if asked.aperture_radius is not None or not sensors or sensors[0].class_name() != "ThinLensCamera":
        return asked
    lens = mi.traverse(sensors[0])
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
