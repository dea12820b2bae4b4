"""Numbers that no physical scene has."""

from __future__ import annotations

from typing import Any

import numpy as np


def check_parameters(params: Any, mi: Any) -> None:
    """Refuse a loaded scene whose numbers are not physical.

    Raises:
        ValueError: If a parameter is nan or infinite, a reflectance or albedo leaves 0..1, or a light is negative.
    """
    if "spectral" in mi.variant():
        return  # colours are stored there as the coefficients of fitted curves, of any sign and size
    for key in params.keys():  # noqa: SIM118  mitsuba's SceneParameters does not iterate over keys
        value = params[key]
        if isinstance(value, (str, bool, mi.Object)) or "Transform" in type(value).__name__:
            continue
        numbers = np.array(value)
        if numbers.dtype.kind != "f" or numbers.size == 0:
            continue
        lowest, highest = float(numbers.min()), float(numbers.max())  # nan in any element makes both nan
        if not np.isfinite([lowest, highest]).all():
            raise ValueError(f"scene parameter {key} must be finite, got {lowest}..{highest}")
        if ("reflectance" in key or "albedo" in key) and key.endswith(("value", "values", "data")):
            # 1e-4: spectra given as RGB are fitted by Mitsuba, and white comes out a rounding error above 1.
            if lowest < 0 or highest > 1 + 1e-4:
                raise ValueError(f"scene parameter {key} must lie in 0..1 (what is reflected of the light), "
                                 f"got {lowest:.6g}..{highest:.6g}")  # fmt: skip
        if any(word in key for word in ("radiance", "irradiance", "intensity")) and lowest < 0:
            raise ValueError(f"scene parameter {key} must be >= 0 (light), got {lowest:.6g}")
