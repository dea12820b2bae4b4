"""Scene radiance -> mean photons per pixel over one exposure, behind the colour filter."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sensor_model.params import Sensor, require


def check_light(light: NDArray, what: str) -> None:
    """Raise ValueError, with the number of bad values and the place of the first, unless all are finite and >= 0."""
    bad = ~(np.isfinite(light) & (light >= 0))
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        raise ValueError(
            f"{what} must be finite and >= 0, got {light[place]} at {place} "
            f"({int(bad.sum())} of {light.size} values); mend or mask the rendering before exposing it"
        )


def photons_for_electrons(
    radiance: ArrayLike, *, electrons: float, mean_green: float, sensor: Sensor
) -> NDArray[np.float64]:
    """Scale a radiance image so that a mid-grey pixel collects a wanted number of electrons.

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
    require(np.isfinite(electrons) and electrons >= 0, "electrons", "finite and >= 0 e-", electrons)
    require(np.isfinite(mean_green) and mean_green > 0, "mean_green", "finite and > 0", mean_green)
    return radiance * np.asarray(sensor.rgb_response) * (electrons / (mean_green * sensor.eta))
