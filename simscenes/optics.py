"""Additions of a real camera to the pinhole: aperture, motion during the exposure, colour filters. All off by
default.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Camera properties that change the radiance reaching the sensor.

    Attributes:
        aperture_radius: Radius of the lens opening, scene units; 0 for a pinhole; None for the lens of the scene's own
            sensor, a pinhole if it has none.
        focus_distance: z-depth in focus, scene units; goes with an aperture_radius > 0.
        motion: How far each camera travels during its exposure, as a fraction of the way to its neighbours in the rig,
            centred on its pose; None for a camera at rest.
        camera: Name of measured colour sensitivities in colour-science ("Nikon 5100 (NPL)"); None for linear sRGB.

    Raises:
        ValueError: If a value is out of range or the focus is missing.
    """

    aperture_radius: float | None = None
    focus_distance: float | None = None
    motion: float | None = None
    camera: str | None = None

    def __post_init__(self) -> None:
        radius, focus = self.aperture_radius, self.focus_distance
        if radius is not None and not 0 <= radius < math.inf:
            raise ValueError(f"Optics: aperture_radius must be >= 0 and finite, got {radius}; 0 means a pinhole")
        if bool(radius) != (focus is not None) or (focus is not None and not 0 < focus < math.inf):
            raise ValueError(f"Optics: an aperture_radius > 0 goes with a focus_distance > 0, got {radius} and {focus}")
        if self.motion is not None and not 0 < self.motion <= 2:
            raise ValueError(f"Optics: motion is a fraction of the step between views in (0, 2], got {self.motion}")
