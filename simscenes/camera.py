"""Colour sensitivities of a camera: how its filters respond to spectra, and the matrix that stands in for them in RGB.

Camera RGB is the integral of radiance times sensitivity, divided by the integral of the green sensitivity: a flat
spectrum of radiance 1 gives green 1; red and blue show how much less or more of it the camera sees. Wavelengths in nm.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
WAVELENGTHS = np.arange(380.0, 781.0, 5.0)


@dataclass(frozen=True)
class CameraColor:
    """A camera's colour filters.

    Attributes:
        name: As in colour-science's MSDS_CAMERA_SENSITIVITIES.
        curves: Sensitivities [wavelength,3] on `WAVELENGTHS`, relative.
        matrix: Linear sRGB -> camera RGB [3,3], fitted to the ColorChecker in daylight D65.
        matrix_error: Relative L1 error of that matrix on those patches: the cost of RGB before any interreflection.
    """

    name: str
    curves: Float
    matrix: Float
    matrix_error: float

    @property
    def green_integral(self) -> float:
        """Integral of the green sensitivity, nm."""
        return float(np.trapezoid(self.curves[:, 1], WAVELENGTHS))

    def film(self, width: int, height: int) -> dict[str, Any]:
        """Mitsuba film whose channels are the integrals of radiance times sensitivity."""
        film: dict[str, Any] = {
            "type": "specfilm",
            "width": width,
            "height": height,
            "component_format": "float32",
            "rfilter": {"type": "box"},
        }
        for k, c in enumerate("RGB"):  # Mitsuba sorts the channels by name
            values = ", ".join(f"{v:.7g}" for v in self.curves[:, k])
            film[f"c{k}_{c}"] = {"type": "regular", "wavelength_min": 380.0, "wavelength_max": 780.0, "values": values}
        return film


@functools.lru_cache
def srgb_curves() -> Float:
    """The weights of linear sRGB for spectra, [wavelength,3] on `WAVELENGTHS`; a flat spectrum has luminance 1."""
    import colour

    shape = colour.SpectralShape(380, 780, 5)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    return np.asarray(observer @ colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB.T / observer[:, 1].sum())


@functools.lru_cache
def daylight() -> Float:
    """D65 on `WAVELENGTHS`, relative: the light in which sRGB, and so Mitsuba, takes the colour of a reflectance."""
    import colour

    return np.asarray(colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(380, 780, 5)).values)


@functools.lru_cache
def camera_color(name: str) -> CameraColor:
    """Look up a camera's measured sensitivities and fit the matrix that RGB rendering needs.

    Raises:
        ValueError: If colour-science has no camera of that name.
    """
    import colour

    known = colour.MSDS_CAMERA_SENSITIVITIES
    if name not in known:
        raise ValueError(f"camera must be one of {sorted(known)}, got {name!r}")
    shape = colour.SpectralShape(380, 780, 5)
    curves = np.clip(np.nan_to_num(known[name].copy().align(shape).values), 0, None)
    light = daylight()
    patches = colour.SDS_COLOURCHECKERS["BabelColor Average"].values()
    reflectance = np.stack([p.copy().align(shape).values for p in patches] + [np.ones(len(light))])
    seen, exact = (reflectance * light) @ srgb_curves(), (reflectance * light) @ curves / curves[:, 1].sum()
    matrix = np.linalg.lstsq(seen, exact, rcond=None)[0].T
    error = np.abs(seen @ matrix.T - exact).sum() / np.abs(exact).sum()
    return CameraColor(name, curves, matrix, float(error))
