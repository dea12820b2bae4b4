"""One exposure, read top to bottom in physical order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sensor_model import effects, moments, streams
from sensor_model.params import Exposure, Sensor, require
from sensor_model.plan import Plan
from sensor_model.planner import simplify
from sensor_model.radiometry import check_light

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RawFrame:
    """Digital numbers of one exposure; the analytic maps are computed when first asked for."""

    dn: NDArray[np.uint16]  # [h, w] or [h, w, 3]
    saturated: NDArray[np.bool_]  # this exposure reached the full well or the top of the ADC here
    photons: NDArray  # the light it was taken of
    sensor: Sensor  # as simulated: without what the plan left out
    exposure: Exposure

    @cached_property
    def _moments(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        mean, variance = expected(self.photons, self.sensor, self.exposure)
        return mean.astype(np.float32), variance.astype(np.float32)

    @property
    def mean_dn(self) -> NDArray[np.float32]:
        """Mean over all frames of this light by this camera: with its fixed pattern, clipping included. DN."""
        return self._moments[0]

    @property
    def variance_dn(self) -> NDArray[np.float32]:
        """Temporal variance of each pixel, clipping and rounding included. DN**2."""
        return self._moments[1]

    @cached_property
    def clean_dn(self) -> NDArray[np.float32]:
        """What the same light gives without noise and without fixed pattern; saturates, is not rounded. DN."""
        s = self.sensor
        charge = effects.collect(
            np.asarray(self.photons, np.float64), eta=s.eta, response=1.0, dark_e=s.dark_current * self.exposure.time
        )
        return np.minimum(s.gain * charge + s.black_level, s.white_dn).astype(np.float32)


def expose(
    photons: ArrayLike,
    sensor: Sensor,
    exposure: Exposure,
    *,
    seed: int,
    view: int,
    frame: int = 0,
    plan: Plan | None = None,
) -> RawFrame:
    """Take one frame.

    Args:
        photons: Mean photons per pixel over the exposure, behind the colour filter, finite and >= 0: [h, w] for a
            mosaic or monochrome sensor, [h, w, 3] for three chips (`cfa=None`).
        sensor: The camera.
        exposure: How it is used.
        seed: With `view` and `frame` it fixes the temporal noise; the fixed pattern follows from `sensor.serial`.
        view: Which camera position this is, 0..2**32-1.
        frame: Which frame of that position, 0..2**32-1.
        plan: Effects to leave out, from `plan_effects`; None simulates all. The others keep their draws.

    Returns:
        The frame, with its analytic mean and variance.

    Raises:
        ValueError: if the photons are NaN, infinite or negative anywhere, or of the wrong shape.
    """
    photons = check_photons(photons, sensor)
    s = simplify(sensor, plan)
    draws = streams.Draws(seed=seed, view=view, frame=frame, origin=exposure.origin)

    mu_e = mean_charge(photons, s, exposure)
    charge = effects.shot_noise(draws.uniforms(mu_e.shape, streams.PIXEL, streams.SHOT_WORD), mu_e)
    signal = effects.full_well(charge, s.mu_e_sat)
    read = draws.uniforms(mu_e.shape, streams.PIXEL, streams.READ_WORD)
    signal = signal + effects.read_noise(read, s.sigma_d, s.tukey_lambda)
    rows = (mu_e.shape[0], 1, *mu_e.shape[2:])
    signal += s.sigma_row * effects.standard_normal(draws.uniforms(rows, streams.ROW))
    signal += s.dsnu * fixed_pattern(s.serial, mu_e.shape, exposure.origin, streams.DSNU)
    dn = effects.digitise(s.gain * signal + s.black_level, s.max_dn)
    return RawFrame(
        dn=dn, saturated=(charge >= s.mu_e_sat) | (dn == s.max_dn), photons=photons, sensor=s, exposure=exposure
    )


def check_photons(photons: ArrayLike, sensor: Sensor) -> NDArray:
    """The photons as an array, or ValueError."""
    photons = np.asarray(photons)
    require(photons.dtype.kind in "fiu", "photons", "real numbers", photons.dtype)
    fits = photons.ndim == 2 or (photons.ndim == 3 and photons.shape[2] == 3 and sensor.cfa is None)
    rule = "[h, w]" if sensor.cfa else "[h, w] or [h, w, 3]"
    require(fits and photons.size > 0, "photons", f"of shape {rule}", photons.shape, "use mosaic() for a colour filter")
    check_light(photons, "photons")
    return photons


def mean_charge(photons: NDArray, sensor: Sensor, exposure: Exposure) -> Array:
    """Mean charge of each pixel of this very camera, e-."""
    response: Array | float = 1.0
    if sensor.prnu:
        normal = fixed_pattern(sensor.serial, photons.shape, exposure.origin, streams.PRNU)
        response = np.maximum(1 + sensor.prnu * normal, 0)
    dark_e = sensor.dark_current * exposure.time
    mu_e = effects.collect(photons.astype(np.float64), eta=sensor.eta, response=response, dark_e=dark_e)
    # A pixel this far over saturation is full in every frame; the cap keeps huge lights inside what Poisson can count.
    top = sensor.capacity_e + 20 * sensor.sigma_d
    return np.minimum(mu_e, top + 10 * np.sqrt(top) + 100)


@lru_cache(maxsize=6)  # a camera keeps its pattern over all views
def fixed_pattern(serial: int, shape: tuple[int, ...], origin: tuple[int, int], stream: int) -> Array:
    """Standard normal pattern of one camera: the same for every view, frame and seed. Read-only."""
    pattern = effects.standard_normal(streams.Draws(seed=serial, origin=origin).uniforms(shape, stream))
    pattern.flags.writeable = False
    return pattern


def expected(photons: NDArray, sensor: Sensor, exposure: Exposure) -> tuple[Array, Array]:
    """Analytic mean and variance of `expose(...).dn` over frames, DN and DN**2."""
    s = sensor
    mean_e, variance_e = moments.charge_moments(mean_charge(photons, s, exposure), s.mu_e_sat)
    if s.dsnu:
        mean_e = mean_e + s.dsnu * fixed_pattern(s.serial, photons.shape, exposure.origin, streams.DSNU)
    variance_e = variance_e + s.sigma_d**2 + s.sigma_row**2
    return moments.adc_moments(s.gain * mean_e + s.black_level, s.gain**2 * variance_e, s.max_dn)
