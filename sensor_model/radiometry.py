"""Scene light -> mean photons per pixel over one exposure, behind the colour filter.

Two ways that meet: physical units (radiance, lux, exposure value, lens) and the normalised axis of noise studies,
electrons per green pixel. SI units; wavelengths in nm.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import constants

from sensor_model.params import Exposure, Sensor, require

LUMENS_PER_WATT = 683.0  # at 555 nm, by definition of the candela (540 THz)
GREEN_NM = 555.0
REFLECTED_LIGHT = 12.5  # cd s / m**2 at ISO 100: calibration constant of reflected-light meters, ISO 2720
Array = NDArray[np.float64]


def check_light(light: NDArray, what: str) -> None:
    """Raise ValueError, with the number of bad values and the place of the first, unless all are finite and >= 0."""
    bad = ~(np.isfinite(light) & (light >= 0))
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        raise ValueError(
            f"{what} must be finite and >= 0, got {light[place]} at {place} "
            f"({int(bad.sum())} of {light.size} values); fix or mask the rendering before exposing it"
        )


@dataclass(frozen=True, kw_only=True)
class Lens:
    """The part of the scene that a pixel sees."""

    f_number: float
    pixel_pitch: float  # m
    transmission: float = 1.0  # of glass, cover and microlens, 0..1
    magnification: float = 0.0  # image over object size; 0: distant scene

    def __post_init__(self) -> None:
        """Check every field."""
        require(isfinite(self.f_number) and self.f_number >= 0.5, "f_number", ">= 0.5", self.f_number, "1/(2 sin 90)")
        require(0 < self.pixel_pitch < 1e-3, "pixel_pitch", "in (0, 1e-3) m", self.pixel_pitch, "2.25e-6 for 2.25 um")
        require(0 < self.transmission <= 1, "transmission", "in (0, 1]", self.transmission)
        require(self.magnification >= 0, "magnification", ">= 0", self.magnification)

    @property
    def etendue(self) -> float:
        """Area times solid angle of the light one pixel accepts, pi A T / (4 N**2 (1 + m)**2). m**2 sr."""
        working = self.f_number * (1 + self.magnification)
        return pi * self.pixel_pitch**2 * self.transmission / (4 * working**2)


def photons_from_radiance(radiance: ArrayLike, lens: Lens, exposure: Exposure, *, wavelength: float) -> Array:
    """Photons per pixel from narrow-band radiance: L etendue t lambda / (h c).

    Args:
        radiance: Any shape, finite and >= 0, W / (m**2 sr).
        lens: Geometry of the light's way to a pixel.
        exposure: Its time.
        wavelength: nm.

    Returns:
        Mean photons, shape of `radiance`.
    """
    radiance = np.asarray(radiance, np.float64)
    check_light(radiance, "radiance")
    energy = constants.h * constants.c / (wavelength * 1e-9)  # J per photon
    return radiance * (lens.etendue * exposure.time / energy)


def photons_from_spectrum(
    radiance: ArrayLike, wavelengths: ArrayLike, lens: Lens, exposure: Exposure, *, qe: ArrayLike, eta: float
) -> Array:
    """Effective photons per pixel and channel from spectral radiance.

    Args:
        radiance: [..., k], W / (m**2 sr nm).
        wavelengths: [k], increasing, nm.
        lens: Geometry of the light's way to a pixel.
        exposure: Its time.
        qe: [k, c] quantum efficiency of each channel, filter included.
        eta: Quantum efficiency the sensor will apply (`Sensor.eta`); divided out here.

    Returns:
        [..., c], so that eta times it is the charge, the integral of photons times quantum efficiency (trapezoids).
    """
    radiance, grid, qe = (np.asarray(a, np.float64) for a in (radiance, wavelengths, qe))
    check_light(radiance, "spectral radiance")
    ok = grid.ndim == 1 and qe.ndim == 2 and radiance.shape[-1:] == grid.shape == qe.shape[:1]
    require(ok, "wavelengths, qe", "[k] and [k, c] for radiance [..., k]", (radiance.shape, grid.shape, qe.shape))
    require(grid.size > 1 and bool((np.diff(grid) > 0).all()), "wavelengths", "increasing, nm", grid[:3])
    per_joule = grid * 1e-9 / (constants.h * constants.c)
    return radiance @ (qe * (_trapezoids(grid) * per_joule)[:, None]) * (lens.etendue * exposure.time / eta)


def channel_response(wavelengths: ArrayLike, qe: ArrayLike, spectrum: ArrayLike) -> tuple[float, tuple[float, ...]]:
    """Sensor parameters from quantum efficiency curves: peak `eta` of green, and `rgb_response` under a light.

    Args:
        wavelengths: [k], nm.
        qe: [k, 3] for red, green, blue.
        spectrum: [k] of the light on a white surface, any radiometric unit.
    """
    grid, qe, spectrum = (np.asarray(a, np.float64) for a in (wavelengths, qe, spectrum))
    charge = (_trapezoids(grid) * spectrum * grid) @ qe
    return float(qe[:, 1].max()), tuple(float(c) for c in charge / charge[1])


def _trapezoids(grid: NDArray) -> NDArray:
    steps = np.diff(grid)
    return 0.5 * (np.append(steps, 0) + np.append(0, steps))


def luminance_from_lux(lux: float, reflectance: float = 0.18) -> float:
    """Luminance of a matt surface under an illuminance: rho E / pi. cd/m**2."""
    require(lux >= 0 and 0 <= reflectance <= 1, "lux, reflectance", ">= 0 and in [0, 1]", (lux, reflectance))
    return reflectance * lux / pi


def luminance_from_ev(ev: float) -> float:
    """Luminance that a reflected-light meter rates at this exposure value for ISO 100: 2**EV K / 100. cd/m**2."""
    return 2.0**ev * REFLECTED_LIGHT / 100


def electrons_from_luminance(luminance: float, lens: Lens, exposure: Exposure, *, eta: float) -> float:
    """Charge of a green pixel that sees a surface of this luminance: the `electrons` of `photons_for_electrons`.

    All light is taken as 555 nm. For a green channel 100 nm wide (full width at half maximum, at 535 nm) that is
    right to 1 % under D65 and 22 % too high under tungsten; use `photons_from_spectrum` where it matters.

    Args:
        luminance: cd/m**2, e.g. from `luminance_from_lux` or `luminance_from_ev`.
        lens: Geometry of the light's way to a pixel.
        exposure: Its time.
        eta: Quantum efficiency.

    Returns:
        Mean electrons.
    """
    return float(eta * photons_from_radiance(luminance / LUMENS_PER_WATT, lens, exposure, wavelength=GREEN_NM))


def photons_for_electrons(radiance: ArrayLike, *, electrons: float, mean_green: float, sensor: Sensor) -> Array:
    """Scale a radiance image so that a green pixel of a given radiance collects a given number of electrons.

    Args:
        radiance: Linear [h, w, 3], any unit, finite and >= 0.
        electrons: Mean charge of a green pixel whose radiance is `mean_green`, e-.
        mean_green: Green radiance that is to give `electrons`: usually the mean over the whole set of views, so that
            all views share one exposure.
        sensor: Its `eta` and `rgb_response` are used.

    Returns:
        Mean photons per pixel behind the filter, [h, w, 3].

    Raises:
        ValueError: if the radiance is not [h, w, 3], or any number is out of range.
    """
    radiance = np.asarray(radiance, np.float64)
    require(radiance.ndim == 3 and radiance.shape[2] == 3, "radiance", "of shape [h, w, 3]", radiance.shape)
    check_light(radiance, "radiance")
    require(isfinite(electrons) and electrons >= 0, "electrons", "finite and >= 0 e-", electrons)
    require(isfinite(mean_green) and mean_green > 0, "mean_green", "finite and > 0", mean_green)
    return radiance * np.asarray(sensor.rgb_response) * (electrons / (mean_green * sensor.eta))


def rolling_shutter(flux: ArrayLike, times: ArrayLike, exposure: Exposure) -> Array:
    """Photons that each row collects from a light that changes while the rows are read one after the other.

    Row r is open from r * line_time to r * line_time + time; between its samples the light is taken as linear.

    Args:
        flux: [t, h, w] or [t, h, w, 3] photons per second and pixel.
        times: [t], increasing, s; must span the time from the first row's start to the last row's end.
        exposure: Its `time`, `line_time` and the first row's number in `origin`.

    Returns:
        Mean photons, [h, w] or [h, w, 3].
    """
    flux, times = np.asarray(flux, np.float64), np.asarray(times, np.float64)
    ok = flux.ndim in (3, 4) and times.shape == flux.shape[:1] and times.size > 1 and bool((np.diff(times) > 0).all())
    require(ok, "flux, times", "[t, h, w(, 3)] and [t], increasing", (flux.shape, times.shape))
    check_light(flux, "flux")
    starts = (np.arange(flux.shape[1]) + exposure.origin[0]) * exposure.line_time
    span = (float(starts[0]), float(starts[-1] + exposure.time))
    require(times[0] <= span[0] and span[1] <= times[-1], "times", f"spanning {span} s", (times[0], times[-1]))
    weights = _integral_weights(times, starts + exposure.time) - _integral_weights(times, starts)
    return np.einsum("rt,tr...->r...", weights, flux)


def _integral_weights(times: NDArray, ends: NDArray) -> NDArray:
    """Weights [r, t] of the samples in the integral of their linear interpolation from times[0] to each end."""
    step = np.clip(ends[:, None] - times[:-1], 0, np.diff(times))  # how far each interval is covered
    later = 0.5 * step**2 / np.diff(times)
    weights = np.zeros((ends.size, times.size))
    weights[:, :-1] += step - later
    weights[:, 1:] += later
    return weights
