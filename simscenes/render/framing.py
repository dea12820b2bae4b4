"""The sensor that a scene comes with: as a rig of one view, and its lens."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.backend import backend_of, using_variant
from simscenes.loading.load import LoadedScene, build_in_fewest_colors
from simscenes.loading.reference import SceneLike, SceneRef
from simscenes.optics import Optics
from simscenes.render.geometry import geometry_channels, shrunk
from simscenes.rigs import Rig, mitsuba_to_intrinsics, mitsuba_to_opencv

Float = NDArray[np.float64]
WHY_NOT = {  # of the sensors that have no pinhole camera's rays
    "OrthographicCamera": " (its rays are parallel, the rays of our cameras meet in a point)",
    "DistantSensorImpl": " (it measures light that leaves the scene, and takes no picture)",
    "IrradianceMeter": " (it measures light on a surface, and takes no picture)",
    "RadianceMeter": " (it measures a single ray, and takes no picture)",
    "BatchSensor": " (name the sensors within it one by one)",
}
MAX_PIXELS = 1 << 26  # an untrusted file must not ask for all memory
GRID = 32  # rays across a sensor's image that find surfaces hidden by its clip planes


def own_rig(loaded: LoadedScene, mi: Any, width: int | None = None, height: int | None = None) -> Rig:
    """The scene's own sensor as a rig of one view.

    A clip plane of the sensor that hides a surface is not kept; a warning says so.

    Args:
        loaded: The scene.
        mi: The mitsuba module.
        width: Image width in pixels; None for the sensor's film. The horizontal field of view is kept.
        height: Image height in pixels; None for the sensor's film.

    Raises:
        ValueError: If the scene has no sensor, or not a perspective one, or it is mirrored.
    """
    which = f"sensor {loaded.sensor} of scene {loaded.name!r}"
    sensor, seen = loaded.own_sensor, "none" if loaded.own_sensor is None else loaded.own_sensor.class_name()
    if seen not in ("PerspectiveCamera", "ThinLensCamera"):
        why = WHY_NOT.get(seen, "")
        raise ValueError(f"{which} must be perspective or thinlens, so that cameras can be found by it, it is "
                         f"{seen}{why}; add one, name another by its number (--sensor-index), or give the rig "
                         "in Python")  # fmt: skip
    film = sensor.film()
    crop_width, crop_height = (int(n) for n in film.crop_size())
    w, h = width or crop_width, height or crop_height
    if min(crop_width, crop_height) < 1:
        raise ValueError(f"{which} must have a film of at least one pixel, got {crop_width} x {crop_height}: correct "
                         "its size")  # fmt: skip
    if w * h > MAX_PIXELS:
        raise ValueError(f"scene {loaded.name!r} asks for a film of {w} x {h} pixels, more than {MAX_PIXELS >> 20} Mi; "
                         "give width and height")  # fmt: skip
    K = _film_intrinsics(mi.traverse(sensor), film)
    K[0] *= w / crop_width  # the field of view is kept across, pixels stay square, the centre keeps its relative place
    K[1, 1], K[1, 2] = K[0, 0], K[1, 2] * h / crop_height
    to_world = np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4, -1)[..., 0]
    to_world[:3, :3] /= np.linalg.norm(to_world[:3, :3], axis=0)  # some exporters leave a scale in the pose
    if np.linalg.det(to_world[:3, :3]) < 0:
        raise ValueError(f"{which} is mirrored: its to_world holds a scale of negative sign, and no camera sees a "
                         "mirror image; take the sign out")  # fmt: skip
    rig = Rig(viewmats=mitsuba_to_opencv(to_world)[None], Ks=K[None], width=w, height=h)
    _say_what_was_hidden(loaded, mi, rig, which)
    return rig


def _say_what_was_hidden(loaded: LoadedScene, mi: Any, rig: Rig, which: str) -> None:
    """Warn if the sensor's clip planes hide surfaces; our cameras show these, as their own planes hide nothing."""
    params = mi.traverse(loaded.own_sensor)
    near, far = (float(np.array(params[f"{plane}_clip"]).item()) for plane in ("near", "far"))
    z = geometry_channels(mi, loaded, shrunk(rig, 0, GRID), 0)["Z"]
    for name, plane, hidden in (("near", near, z < near), ("far", far, np.isfinite(z) & (z > far))):
        if hidden.any():
            warnings.warn(f"{which} has {name}_clip {plane:g}, which hides surfaces in {hidden.mean():.0%} of its "
                          "picture. It is not kept: pictures and depth show them. Remove them from the scene to look "
                          "past them", stacklevel=3)  # fmt: skip


def own_cameras(
    scene: SceneLike | SceneRef | LoadedScene,
    width: int | None = None,
    height: int | None = None,
    *,
    own_lenses: bool = True,
    allow_outside: bool = False,
) -> Rig:
    """All of a scene's own sensors as a rig, in the order of the scene.

    A warning says where a film and the pictures differ in shape: the horizontal field of view is kept, so more or less
    is seen above and below.

    Args:
        scene: As for `fit_rig`.
        width: As for `own_rig`.
        height: As for `own_rig`.
        own_lenses: Whether the sensors' lenses count; False where the user has chosen one lens for all cameras.
        allow_outside: As for `render_set`.

    Raises:
        ValueError: As `own_rig`, or if the films differ in size where it is not given, or their lenses differ.
    """
    loaded = opened(scene, allow_outside)
    with using_variant(loaded.variant) as mi:
        each = [replace(loaded, sensor=k) for k in range(max(len(loaded.scene.sensors()), 1))]
        rigs = [own_rig(one, mi, width, height) for one in each]
        if own_lenses:
            _check_one_lens(each, mi)
        _say_what_is_reshaped(each, rigs)
    sizes = sorted({(rig.width, rig.height) for rig in rigs})
    if len(sizes) > 1:
        raise ValueError(f"scene {loaded.name!r} has sensors of {len(sizes)} sizes, {sizes[0]} to {sizes[-1]}: one set "
                         "has pictures of one size; give width and height")  # fmt: skip
    viewmats, Ks = (np.concatenate([getattr(rig, name) for rig in rigs]) for name in ("viewmats", "Ks"))
    return Rig(viewmats=viewmats, Ks=Ks, width=rigs[0].width, height=rigs[0].height)


def _check_one_lens(each: list[LoadedScene], mi: Any) -> None:
    lenses = [_lens(one.own_sensor, mi) for one in each]
    for k, lens in enumerate(lenses):
        if lens != lenses[0]:
            first, other = ("a pinhole" if not one else "an aperture radius of {:g}, focused at {:g}".format(*one)
                            for one in (lenses[0], lens))  # fmt: skip
            raise ValueError(f"the cameras of a set share one lens; of scene {each[0].name!r} sensor 0 has {first}, "
                             f"sensor {k} {other}. Choose one for all (--aperture-radius; 0 is a pinhole)")  # fmt: skip


def _say_what_is_reshaped(each: list[LoadedScene], rigs: list[Rig]) -> None:
    for one, rig in zip(each, rigs, strict=True):
        w, h = (int(n) for n in one.own_sensor.film().crop_size())
        if w * rig.height != h * rig.width:
            more = "more" if h / w < rig.height / rig.width else "less"
            warnings.warn(f"sensor {one.sensor} of scene {one.name!r} has a film of {w} x {h} pixels: pictures of "
                          f"{rig.width} x {rig.height} show {more} above and below", stacklevel=3)  # fmt: skip
            return  # once is enough


def _lens(sensor: Any, mi: Any) -> tuple[float, float] | None:
    """Aperture radius and focus distance of a sensor; None for a pinhole."""
    if sensor is None or sensor.class_name() != "ThinLensCamera":
        return None
    params = mi.traverse(sensor)
    radius, focus = (float(np.array(params[key]).item()) for key in ("aperture_radius", "focus_distance"))
    return radius, focus


def with_lens(asked: Optics | None, loaded: LoadedScene, mi: Any) -> Optics:
    """The requested optics, with the lens of the scene's own sensor where none is given; a pinhole has none.

    A thin lens keeps its focus distance for all cameras of a rig: cameras of `fit_rig` keep their distance to the
    target.
    """
    asked = asked or Optics()
    if asked.aperture_radius == 0:
        return replace(asked, aperture_radius=None)
    lens = _lens(loaded.own_sensor, mi)
    if asked.aperture_radius is not None or lens is None:
        return asked
    return replace(asked, aperture_radius=lens[0], focus_distance=lens[1])


def _film_intrinsics(params: Any, film: Any) -> Float:
    """Intrinsics [3,3] of a sensor in pixels of its crop; Mitsuba's angle and offsets belong to the whole film."""

    def number(key: str) -> float:
        return float(np.array(params[key]).ravel()[0]) if key in params.keys() else 0.0

    ppx, ppy = number("principal_point_offset_x"), number("principal_point_offset_y")
    K = mitsuba_to_intrinsics(number("x_fov"), ppx, ppy, *(int(n) for n in film.size()))
    K[:2, 2] -= np.array(film.crop_offset(), dtype=np.float64).ravel()
    return K


def opened(scene: SceneLike | SceneRef | LoadedScene, allow_outside: bool) -> LoadedScene:
    """The scene in a variant with as few colours as it can be loaded in; a scene that is loaded already stays
    unchanged.
    """
    if isinstance(scene, LoadedScene):
        return scene
    return build_in_fewest_colors(scene, backend_of(), allow_outside=allow_outside)
