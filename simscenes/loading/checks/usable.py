"""Plugins that Mitsuba loads and then cannot render, or whose light no path finds."""

from __future__ import annotations

from typing import Any

import numpy as np

from simscenes.loading.contents import class_of, surfaces_in

# Plugins that a path tracer cannot use, by class.
UNUSABLE = {
    "DirectionalArea": (
        "a 'directionalarea' emitter, whose light no path from a camera can find; use 'area', 'spot' or 'projector'"
    ),
}
# Its scalar variants crash; llvm showed the lamp right, and a floor under it eight times too dark.
PAINTED_LAMP = (
    "a lamp whose radiance is a 'mesh_attribute': Mitsuba cannot sample its light, so that all it shines on is too "
    "dark; give it one colour, or a bitmap and texture coordinates"
)
# RGB takes the codes of directions for those of colours, without a word, and tilts every surface.
COLOURED_NORMALS = (
    "a 'normalmap' whose bitmap is read as colours: directions are no colours; add <boolean name=\"raw\" "
    'value="true"/> to the bitmap'
)
# Plugins that only spectral variants can read, by class; in RGB Mitsuba would find out in the middle of a render.
SPECTRAL = {
    "RegularSpectrum": "a 'regular' spectrum, which only spectral variants can read; write it as type 'spectrum' with "
    "pairs of wavelength and value",
    "IrregularSpectrum": "an 'irregular' spectrum, which only spectral variants can read; write it as type 'spectrum' "
    "with pairs of wavelength and value",
    "BlackBodySpectrum": "a 'blackbody' spectrum, which only spectral variants can read",
}
COLORS = frozenset({
    "base_color", "color0", "color1", "diffuse_reflectance", "diffuse_transmittance", "eta", "intensity", "irradiance",
    "k", "radiance", "reflectance", "specular_reflectance", "specular_transmittance", "transmittance",
})  # fmt: skip  # textures asked for a colour, by their names in the plugin that uses them; others for a number


def why_unusable(scene: Any, mi: Any) -> str:
    """A fault that Mitsuba would only find while rendering, or never: the plugin and the reason; "" if all can be used.

    It says "spectral" if another variant can render it. The caller lets go of the scene before it raises: while an
    object that RGB cannot evaluate is alive, llvm and cuda render no other scene in RGB either.
    """
    spectral = "spectral" in mi.variant()
    for label, part in _parts(scene, mi):
        kind = class_of(part)
        if kind in UNUSABLE:
            return UNUSABLE[kind]
        if kind in SPECTRAL and not spectral:
            return SPECTRAL[kind]
        if label == "radiance" and kind.startswith("MeshAttribute"):
            return PAINTED_LAMP
        if label == "normalmap" and kind == "BitmapTextureImpl" and "raw = 0" in str(part):
            return COLOURED_NORMALS
    if spectral and (raw := raw_color(scene, mi)):
        return (
            f"a bitmap with raw = true as {raw}: it has no spectrum, and is for RGB alone; leave raw out where a "
            "picture is a colour"
        )
    return ""


def masked_lamps(scene: Any, mi: Any) -> list[str]:
    """A warning about each lamp with an opacity below 1: Mitsuba heeds that where a camera looks at it, and nowhere
    else.
    """
    found = []
    for shape in surfaces_in(scene, mi):
        if shape.emitter() is None or shape.bsdf() is None or class_of(shape.bsdf()) != "MaskBSDF":
            continue
        params = mi.traverse(shape.bsdf())
        keys = (key for key in params.keys() if key.startswith("opacity.") and not key.endswith(".to_uv"))
        if any(np.array(params[key]).min() < 1 for key in keys):
            found.append(f"the lamp {shape.id() or shape.class_name()!r} has an opacity (in glTF an alpha) below 1: "
                         "Mitsuba shows it so to the camera, and lights all else as if it were whole. Cut the holes "
                         "into its mesh, or let only the whole parts shine")  # fmt: skip
    return found


def raw_color(scene: Any, mi: Any) -> str:
    """The parameter that the first raw bitmap used as a colour belongs to; "" without such a bitmap."""
    labels = (label for label, part in _parts(scene, mi)
              if label in COLORS and class_of(part) == "BitmapTextureImpl" and "raw = 1" in str(part))  # fmt: skip
    return next(labels, "")


def _parts(scene: Any, mi: Any) -> list[tuple[str, Any]]:
    """Every object once for each name that it is used by, shared ones included, with the last part of that name."""
    found: dict[tuple[str, Any], None] = {}
    visited: set[Any] = set()

    class Walk(mi.TraversalCallback):
        def put(self, name: str, value: Any, *flags: Any) -> None:
            if isinstance(value, mi.Object):
                found[name.rpartition(".")[2], value] = None
                if value not in visited:
                    visited.add(value)
                    value.traverse(Walk())

    scene.traverse(Walk())
    return list(found)
