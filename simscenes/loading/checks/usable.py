"""Plugins that Mitsuba loads and then cannot render, or whose light no path finds."""

from __future__ import annotations

from typing import Any

# What a path tracer cannot use, by class.
UNUSABLE = {
    "DirectionalArea": (
        "a 'directionalarea' emitter, whose light no path from a camera can find; use 'area', 'spot' or 'projector'"
    ),
}
# What only spectral variants can read, by class; in RGB Mitsuba would find out in the middle of a render.
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
})  # fmt: skip  # textures that are asked for a colour, by their names in what uses them; the others for a number


def check_usable(scene: Any, mi: Any, name: str) -> None:
    """Refuse what Mitsuba would only find out while rendering, or never.

    Args:
        scene: A loaded scene.
        mi: The mitsuba module.
        name: Of the scene, for messages.

    Raises:
        ValueError: If the scene holds such a thing. The message says "spectral" if another variant can render it.
    """
    spectral = "spectral" in mi.variant()
    for _, part in _parts(scene, mi):
        kind = _class(part)
        if kind in UNUSABLE:
            raise ValueError(f"scene {name!r} holds {UNUSABLE[kind]}")
        if kind in SPECTRAL and not spectral:
            raise ValueError(f"scene {name!r} holds {SPECTRAL[kind]}")
    if spectral and (raw := raw_color(scene, mi)):
        raise ValueError(
            f"scene {name!r} holds a bitmap with raw = true as {raw}: it has no spectrum, and is for RGB alone; leave "
            "raw out where a picture is a colour"
        )


def raw_color(scene: Any, mi: Any) -> str:
    """What the first raw bitmap that is used as a colour is used for; "" if there is none."""
    labels = (label for label, part in _parts(scene, mi)
              if label in COLORS and _class(part) == "BitmapTextureImpl" and "raw = 1" in str(part))  # fmt: skip
    return next(labels, "")


def _class(part: Any) -> str:
    return str(part.class_name()).partition("[")[0]


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
