"""Raw frame -> linear RGB, 16-bit and 8-bit sRGB. Stages: black level, white balance, demosaic, clip, tone curve."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sensor_model.capture import RawFrame
from sensor_model.mosaic import channel_index
from sensor_model.params import Cfa, Sensor, require

Demosaic = Literal["menon", "malvar", "bilinear"]
# Code of zero light in `linear16`. Room below it keeps the sign of dark noise: clipping at zero would lift the mean of
# dark pixels by 0.4 standard deviations.
LINEAR16_BLACK = 4096


@dataclass(frozen=True)
class Developed:
    """The two pictures of one exposure."""

    linear16: NDArray[np.uint16]  # [h, w, 3] (or [h, w] for monochrome); read it with `from_linear16`
    srgb8: NDArray[np.uint8]  # same shape; clipped to [black, white], sRGB curve


def develop(
    frame_or_dn: RawFrame | ArrayLike, sensor: Sensor, *, demosaic: Demosaic = "menon", digital_gain: float = 1.0
) -> Developed:
    """Develop one exposure.

    Args:
        frame_or_dn: A frame, or its codes [h, w] (mosaic, monochrome) or [h, w, 3] (three chips).
        sensor: The camera it was taken with.
        demosaic: Interpolation of the colour filter array.
        digital_gain: Factor on the linear values before anything is clipped to white.

    Returns:
        `linear16`: code = 4096 + 61439 * linear, clipped to 0..65535, so 4096 is black, 65535 white and negative noise
        survives down to -6.7 % of white. `srgb8`: clip to 0..1, sRGB curve, 8 bits.

    Raises:
        ValueError: if the shape does not fit the sensor.
    """
    dn = frame_or_dn.dn if isinstance(frame_or_dn, RawFrame) else np.asarray(frame_or_dn)
    linear = develop_linear(dn, sensor, demosaic=demosaic) * np.float32(digital_gain)
    return Developed(linear16=to_linear16(linear), srgb8=to_srgb8(linear))


def develop_linear(dn: ArrayLike, sensor: Sensor, *, demosaic: Demosaic = "menon") -> NDArray[np.float32]:
    """Codes -> white-balanced linear RGB; 1.0 is the white level, nothing is clipped.

    Every channel of a saturated pixel comes out at 1.0 or more, so clipping to 1.0 afterwards leaves no coloured
    highlights. Takes codes or analytic means alike; linear in `dn` for "malvar" and "bilinear", nearly so for "menon"
    (which chooses directions).

    Args:
        dn: [h, w] or [h, w, 3], any real dtype, DN.
        sensor: Its black and white level, filter responses and pattern are used.
        demosaic: Interpolation of the colour filter array.

    Returns:
        [h, w, 3], or [h, w] for a monochrome frame of a sensor without filter array.
    """
    dn = np.asarray(dn)
    fits = dn.ndim == 2 or (dn.ndim == 3 and dn.shape[2] == 3 and sensor.cfa is None)
    require(fits, "dn", "[h, w], or [h, w, 3] without colour filter array", dn.shape)
    linear = (dn.astype(np.float64) - sensor.black_level) / (sensor.white_dn - sensor.black_level)
    gains = white_balance(sensor)
    if sensor.cfa is None:
        return (linear * gains if linear.ndim == 3 else linear).astype(np.float32)
    return interpolate(linear * gains[channel_index(dn.shape, sensor.cfa)], sensor.cfa, demosaic)


def white_balance(sensor: Sensor) -> NDArray[np.float64]:
    """Factors for red, green, blue that make a white surface grey; the smallest is 1."""
    response = np.asarray(sensor.rgb_response)
    return response.max() / response


def interpolate(mosaic: NDArray, cfa: Cfa, demosaic: Demosaic) -> NDArray[np.float32]:
    """Demosaic [h, w] -> [h, w, 3]."""
    require(min(mosaic.shape) >= 2, "a frame with colour filter array", "at least 2 x 2", mosaic.shape)
    with warnings.catch_warnings():
        # colour-demosaicing 0.2.7 imports scipy.ndimage under a name that scipy 2 will drop
        warnings.simplefilter("ignore", DeprecationWarning)
        import colour_demosaicing as library
    functions = {
        "menon": library.demosaicing_CFA_Bayer_Menon2007,
        "malvar": library.demosaicing_CFA_Bayer_Malvar2004,
        "bilinear": library.demosaicing_CFA_Bayer_bilinear,
    }
    require(demosaic in functions, "demosaic", f"one of {tuple(functions)}", demosaic)
    return functions[demosaic](mosaic, cfa).astype(np.float32)


def to_linear16(linear: NDArray) -> NDArray[np.uint16]:
    """Linear values -> codes with a pedestal, see `develop`."""
    scale = 65535 - LINEAR16_BLACK
    return np.clip(np.rint(LINEAR16_BLACK + scale * linear.astype(np.float64)), 0, 65535).astype(np.uint16)


def from_linear16(codes: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Inverse of `to_linear16`: 0.0 black, 1.0 white."""
    return ((codes.astype(np.float64) - LINEAR16_BLACK) / (65535 - LINEAR16_BLACK)).astype(np.float32)


def to_srgb8(linear: NDArray) -> NDArray[np.uint8]:
    """Linear values -> 8-bit sRGB; below black and above white are clipped, as in any 8-bit picture."""
    return np.rint(255 * linear_to_srgb(np.clip(linear, 0, 1))).astype(np.uint8)


def linear_to_srgb(linear: ArrayLike) -> NDArray:
    """IEC 61966-2-1 curve; negative values follow its straight part, so that noise keeps its sign."""
    x = _floating(linear)
    # The power is undefined below zero and unused below the joint
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055).astype(x.dtype)


def srgb_to_linear(encoded: ArrayLike) -> NDArray:
    """Inverse of `linear_to_srgb`."""
    x = _floating(encoded)
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4).astype(x.dtype)


def _floating(values: ArrayLike) -> NDArray:
    array = np.asarray(values)
    return array if array.dtype.kind == "f" else array.astype(np.float64)
