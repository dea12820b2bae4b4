"""Faults that Mitsuba's scalar variants refuse while they shade, and its wide variants answer with 0 without a word.

Such as a colour of four numbers for each face, or a texture that a lamp cannot place on its mesh. Every material, lamp
and medium of a scene is therefore evaluated once in the scalar variant before a wide one renders it.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from simscenes.loading.contents import media_in, surfaces_in

POINT = (0.3, 0.4)  # where on a surface, and which random numbers: nothing about them is special
ATTRIBUTE = "MeshAttribute"  # in the printed form of a texture that each mesh must bring itself
# By words of Mitsuba's.
ADVICE = {
    "but had size": "colours have three numbers: leave out alpha when the mesh is exported; other values have one",
    "Invalid attribute": "the mesh file has no such values for its vertices or faces: export them, or use a colour",
}


def check_shading(scene: Any, mi: Any) -> None:
    """Evaluate every material, lamp and medium of a scene once, in a scalar variant.

    Raises:
        ValueError: If one fails, with the shape or the class, and Mitsuba's reason.
    """
    known, lamps = set[Any](), set[Any]()
    for shape in surfaces_in(scene, mi):
        bsdf, lamp = shape.bsdf(), shape.emitter()
        lamps.add(lamp)
        # A material that asks nothing of its mesh is the same on all of them.
        if bsdf in known and lamp is None:
            continue
        if bsdf is not None and ATTRIBUTE not in str(bsdf):
            known.add(bsdf)
        _tried(f"shape {shape.id() or shape.class_name()!r}", lambda shape=shape: _shade(shape, mi))
    for emitter in scene.emitters():
        if emitter not in lamps:
            _tried(f"emitter {emitter.class_name()!r}", lambda emitter=emitter: _shine(scene, emitter, mi))
    for medium in media_in(scene, mi):
        _tried(f"medium {medium.class_name()!r}", lambda medium=medium: _scatter(scene, medium, mi))


def _tried(what: str, work: Any) -> None:
    try:
        work()
    except RuntimeError as error:
        said = str(error).splitlines()[-1].strip()
        hint = next((f" ({advice})" for words, advice in ADVICE.items() if words in said), "")
        raise ValueError(f"{what} cannot be shaded, and would be black: {said}{hint}") from error


def _shade(shape: Any, mi: Any) -> None:
    """Its material, and its lamp, at one point of its surface."""
    si = mi.SurfaceInteraction3f()
    si.p, si.n, si.uv = shape.bbox().center(), mi.Normal3f(0, 0, 1), mi.Point2f(POINT)
    with suppress(RuntimeError):  # curves and implicit surfaces give no point
        at = shape.sample_position(0.0, mi.Point2f(POINT))
        si.p, si.n, si.uv = at.p, at.n, at.uv
    si.t, si.prim_index, si.shape, si.sh_frame = 1.0, 0, shape, mi.Frame3f(si.n)
    si.dp_du, si.dp_dv, si.wi = si.sh_frame.s, si.sh_frame.t, mi.Vector3f(0, 0, 1)
    if (bsdf := shape.bsdf()) is not None:
        context = mi.BSDFContext()
        bsdf.eval(context, si, mi.Vector3f(0, 0, 1))
        bsdf.sample(context, si, POINT[0], mi.Point2f(POINT))
    if (lamp := shape.emitter()) is not None:
        lamp.eval(si)
        seen_from = mi.Interaction3f()
        seen_from.p = si.p + si.n
        lamp.sample_direction(seen_from, mi.Point2f(POINT))


def _shine(scene: Any, emitter: Any, mi: Any) -> None:
    """A lamp without a surface, as a point in the middle of the scene sees it."""
    si = mi.SurfaceInteraction3f()
    si.p, si.wi = scene.bbox().center(), mi.Vector3f(0, 0, 1)
    emitter.eval(si)
    emitter.sample_direction(si, mi.Point2f(POINT))


def _scatter(scene: Any, medium: Any, mi: Any) -> None:
    """A medium, in the middle of the scene."""
    at = mi.MediumInteraction3f()
    at.p, at.t, at.wi = scene.bbox().center(), 1.0, mi.Vector3f(0, 0, 1)
    medium.get_scattering_coefficients(at)
    medium.phase_function().sample(mi.PhaseFunctionContext(None), at, POINT[0], mi.Point2f(POINT))
