"""Unphysical numbers, found once a scene is loaded and before any rendering."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.loading.contents import media_in, surfaces_in, unique_materials

# Reflectances and transmittances, by the end of a parameter's name.
SHARES = re.compile(r"(reflectance|albedo|base_color|transmittance|spec_trans)\.(.*\.)?(value|values|data)$")
# The same as a colour of vertices or faces, in Mitsuba's printed form of a material: input, attribute, factor.
OF_MESH = re.compile(
    r"(\w*(?:reflectance|albedo|base_color|transmittance|spec_trans))(?: =|:) MeshAttribute\[\s*name = \"([^\"]+)\",\s*"
    r"scale = \"?([^\",\s\]]+)"
)
UNNAMED = re.compile(r"object_\d+")  # Mitsuba's name for a nameless object: an address, another one each time
# Amounts of light or of a medium, by a part of a parameter's name; other parameters are positions and angles.
AMOUNTS = re.compile(
    r"(^|\.)(radiance|irradiance|intensity|texture|data|scale|sun_scale|sky_scale|sampling_weight|sigma_t)(\.|$)"
)
RAY_OFFSET = 1500 * 2.0**-24  # Mitsuba starts a ray this times (1 + the largest coordinate of x) off the surface at x
# Shares of a scene's size. A picture of a ball on a ground, in small units or far from the origin, was wrong by 0.1 %
# of its mean (RMSE 0.4 %) at the first and by 1 % (3.6 %) at the second.
OFFSET_SAID, OFFSET_REFUSED = 1e-3, 1e-2


def check_parameters(scene: Any, params: Any, mi: Any) -> None:
    """Refuse a loaded scene whose numbers are not physical.

    Raises:
        ValueError: If a parameter is nan or infinite, a reflectance or transmittance leaves 0..1, or a light or medium
            is negative.
    """
    if "spectral" in mi.variant():
        return  # colours are stored there as the coefficients of fitted curves, of any sign and size
    for key in params.keys():  # mitsuba's SceneParameters does not iterate over keys
        numbers = _numbers(params[key], mi)
        lowest, highest = float(numbers.min()), float(numbers.max())  # nan in any element makes both nan
        if not np.isfinite([lowest, highest]).all():
            raise ValueError(f"scene parameter {key} must be finite, got {lowest}..{highest}")
        if SHARES.search(key):
            _check_share(UNNAMED.sub("an unnamed object", key), numbers)
    by_material = {one.bsdf(): OF_MESH.findall(str(one.bsdf())) for one in unique_materials(scene, mi)}
    for shape in surfaces_in(scene, mi):
        for name, attribute, factor in by_material.get(shape.bsdf(), ()):
            inner = mi.traverse(shape)
            # A colour for each vertex or face, or a bitmap of that name. A shape that has neither is left to Mitsuba.
            for key in {attribute, f"{attribute}.data"} & set(inner.keys()):
                numbers = _numbers(inner[key], mi) * float(factor)
                _check_share(f"{name} ({attribute}) of {shape.id() or shape.class_name()!r}", numbers)
    for part in (*scene.emitters(), *media_in(scene, mi)):
        inner = mi.traverse(part)
        for key in filter(AMOUNTS.search, inner.keys()):
            if (lowest := float(_numbers(inner[key], mi).min())) < 0 and "Transform" not in type(inner[key]).__name__:
                raise ValueError(
                    f"scene parameter {key} of {part.class_name()} {part.id()!r} must be >= 0, got {lowest:.6g}"
                )


def _check_share(name: str, numbers: NDArray[Any]) -> None:
    lowest, highest = float(numbers.min()), float(numbers.max())
    # 1e-4: spectra given as RGB are fitted by Mitsuba, and white comes out a rounding error above 1.
    if lowest < 0 or highest > 1 + 1e-4:
        codes = lowest >= 0 and highest <= 255 and bool((numbers % 1 == 0).all())
        hint = ": codes of 8 bits, which Mitsuba takes as they are; write linear light in 0..1 as floats" * codes
        raise ValueError(f"scene parameter {name} must lie in 0..1 (the share of light that a surface or medium passes "
                         f"on), got {lowest:.6g}..{highest:.6g}{hint}")  # fmt: skip


def scene_extent(scene: Any) -> float:
    """Diagonal of the bounding box.

    Raises:
        ValueError: If the shapes take up no room, or not a finite one, or so little for where they are that rays start
            far from their surfaces.
    """
    extents = np.array(scene.bbox().extents())
    diagonal = float(np.linalg.norm(extents))
    if not (np.isfinite(diagonal) and diagonal > 0 and extents.min() >= 0):
        raise ValueError(f"the shapes of a scene must fill a finite box of some size, got extents "
                         f"{extents.ravel().tolist()}; is there a nan or a zero in a transform?")  # fmt: skip
    if (share := offset_share(scene, diagonal)) > OFFSET_REFUSED:
        raise ValueError(f"Mitsuba would start rays {share:.2g} of the scene's size off its surfaces, at most "
                         f"{OFFSET_REFUSED:g} can be: shadows and refraction would be wrong. Its size is "
                         f"{diagonal:.3g} units: scale it to 1 unit or more, and move it to the origin")  # fmt: skip
    return diagonal


def offset_share(scene: Any, extent: float) -> float:
    """How far off its surfaces Mitsuba starts rays at most, in parts of the diagonal `extent`."""
    box = scene.bbox()
    return RAY_OFFSET * (1 + float(np.abs([*box.min, *box.max]).max())) / extent


def offset_warning(scene: Any, extent: float) -> list[str]:
    """A warning about a scene that is small, or far from the origin, but not refused."""
    if (share := offset_share(scene, extent)) <= OFFSET_SAID:
        return []
    return [f"Mitsuba starts rays {share:.2%} of the scene's size off its surfaces, so that shadows and refraction "
            "near contacts are wrong by about as much, and no error states it: scale the scene, whose size is "
            f"{extent:.3g} units, or move it to the origin"]  # fmt: skip


def _numbers(value: Any, mi: Any) -> NDArray[Any]:
    """The real numbers of a parameter; [0.0] if it has none."""
    if "Transform" in type(value).__name__:
        value = value.matrix
    numbers = np.zeros(1) if isinstance(value, (str, bool, mi.Object)) else np.array(value)
    return numbers if numbers.dtype.kind == "f" and numbers.size else np.zeros(1)
