"""The objects of a loaded scene, including parts that only its instances show."""

from __future__ import annotations

from typing import Any


def objects_in(scene: Any, mi: Any) -> list[Any]:
    """Every object of a scene once, in the order in which Mitsuba visits it; shared ones cost no more than others."""
    found: dict[Any, None] = {}

    class Walk(mi.TraversalCallback):
        def put(self, name: str, value: Any, *flags: Any) -> None:
            if isinstance(value, mi.Object) and value not in found:
                found[value] = None
                value.traverse(Walk())  # a new one: a callback in use cannot be called again

    scene.traverse(Walk())
    return list(found)


def class_of(thing: Any) -> str:
    """Name of an object's class, without the number type that some names carry."""
    return str(thing.class_name()).partition("[")[0]


def patterned_sky(scene: Any) -> bool:
    """Whether the background is not equally bright in every direction, so that a turning camera sees it move."""
    sky = scene.environment()
    return sky is not None and class_of(sky) != "ConstantBackgroundEmitter"


def parameters_in(scene: Any, mi: Any) -> dict[str, Any]:
    """The parameters that `mi.traverse` finds in a loaded scene, by name, without optional parameters that are not set.

    A hair without its own absorption has such a one, and Mitsuba fails to read it.
    """
    params, found = mi.traverse(scene), {}
    for key in params.keys():  # mitsuba's SceneParameters does not iterate over keys
        try:
            found[key] = params[key]
        except TypeError:
            continue
    return found


def surfaces_in(scene: Any, mi: Any) -> list[Any]:
    """The shapes that rays hit: first the scene's own, then the shapes of its groups, which its instances repeat.

    Instances and groups have materials too, but Mitsuba invents these, and no ray hits them.
    """
    shapes = scene.shapes()
    if any(_repeats(shape) for shape in shapes):
        known = set(shapes)
        shapes = [*shapes, *(o for o in objects_in(scene, mi) if isinstance(o, mi.Shape) and o not in known)]
    return [shape for shape in shapes if not _repeats(shape)]


def unique_materials(scene: Any, mi: Any) -> list[Any]:
    """One shape for each distinct material, in the order of `surfaces_in`."""
    first: dict[Any, Any] = {}
    for shape in surfaces_in(scene, mi):
        if shape.bsdf() is not None:
            first.setdefault(shape.bsdf(), shape)
    return list(first.values())


def media_in(scene: Any, mi: Any) -> list[Any]:
    """The media on either side of the surfaces, then those around the scene's own sensors."""
    sides = [m for s in surfaces_in(scene, mi) for m in (s.interior_medium(), s.exterior_medium())]
    return [m for m in (*sides, *(sensor.get_medium() for sensor in scene.sensors())) if m is not None]


def _repeats(shape: Any) -> bool:
    return shape.class_name().startswith(("Instance", "ShapeGroup"))
