"""Unphysical numbers, found once a scene is loaded and before any rendering."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.loading.contents import media_in

# Reflectances and transmittances, by the end of a parameter's name.
SHARES = re.compile(r"(reflectance|albedo|base_color|transmittance|spec_trans)\.(.*\.)?(value|values|data)$")
# Amounts of light or of a medium, by a part of a parameter's name; other parameters are positions and angles.
AMOUNTS = re.compile(
    r"(^|\.)(radiance|irradiance|intensity|texture|data|scale|sun_scale|sky_scale|sampling_weight|sigma_t)(\.|$)"
)


def check_parameters(scene: Any, params: Any, mi: Any) -> None:
    """Refuse a loaded scene whose numbers are not physical.

    Raises:
        ValueError: If a parameter is nan or infinite, a reflectance or transmittance leaves 0..1, or a light or medium
            is negative.
    """
    if "spectral" in mi.variant():
        return  # colours are stored there as the coefficients of fitted curves, of any sign and size
    for key in params.keys():  # noqa: SIM118  mitsuba's SceneParameters does not iterate over keys
        numbers = _numbers(params[key], mi)
        lowest, highest = float(numbers.min()), float(numbers.max())  # nan in any element makes both nan
        if not np.isfinite([lowest, highest]).all():
            raise ValueError(f"scene parameter {key} must be finite, got {lowest}..{highest}")
        # 1e-4: spectra given as RGB are fitted by Mitsuba, and white comes out a rounding error above 1.
        if SHARES.search(key) and (lowest < 0 or highest > 1 + 1e-4):
            raise ValueError(f"scene parameter {key} must lie in 0..1 (the share of light that a surface passes on), "
                             f"got {lowest:.6g}..{highest:.6g}")  # fmt: skip
    for part in (*scene.emitters(), *media_in(scene, mi)):
        inner = mi.traverse(part)
        for key in filter(AMOUNTS.search, inner.keys()):
            if (lowest := float(_numbers(inner[key], mi).min())) < 0 and "Transform" not in type(inner[key]).__name__:
                raise ValueError(
                    f"scene parameter {key} of {part.class_name()} {part.id()!r} must be >= 0, got {lowest:.6g}"
                )


def scene_extent(scene: Any) -> float:
    """Diagonal of the bounding box.

    Raises:
        ValueError: If the shapes take up no room, or not a finite one.
    """
    extents = np.array(scene.bbox().extents())
    diagonal = float(np.linalg.norm(extents))
    if not (np.isfinite(diagonal) and diagonal > 0 and extents.min() >= 0):
        raise ValueError(f"the shapes of a scene must fill a finite box of some size, got extents "
                         f"{extents.ravel().tolist()}; is there a nan or a zero in a transform?")  # fmt: skip
    return diagonal


def _numbers(value: Any, mi: Any) -> NDArray[Any]:
    """The real numbers of a parameter; [0.0] if it has none."""
    if "Transform" in type(value).__name__:
        value = value.matrix
    numbers = np.zeros(1) if isinstance(value, (str, bool, mi.Object)) else np.array(value)
    return numbers if numbers.dtype.kind == "f" and numbers.size else np.zeros(1)
