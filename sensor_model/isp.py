"""Raw frame -> linear RGB, 16-bit linear and 8-bit sRGB.

Stages: black level, white balance, demosaic, colour matrix, digital gain, clip, sRGB curve, and optionally JPEG.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sensor_model.mosaicking import bilinear, channel_index, malvar, menon
from sensor_model.params import Cfa, Sensor, require

if TYPE_CHECKING:
    from sensor_model.capture import RawFrame

Demosaic = Literal["menon", "malvar", "bilinear", "half"]
DEMOSAIC: tuple[Demosaic, ...] = get_args(Demosaic)
BORDER = 8  # pixels of mirrored surroundings: even, to keep the pattern's phase, and as far as "menon" reaches
# Code of zero light in `linear16`. Room below it keeps the sign of dark noise: clipping at zero would lift the mean of
# dark pixels by 0.4 standard deviations.
LINEAR16_BLACK = 4096


@dataclass(frozen=True)
class Developed:
    """The two pictures of one exposure."""

    linear16: NDArray[np.uint16]  # [h, w, 3] (or [h, w] for monochrome); read it with `from_linear16`
    srgb8: NDArray[np.uint8]  # same shape; clipped to [black, white], sRGB curve


def develop(
    frame_or_dn: RawFrame | ArrayLike,
    sensor: Sensor,
    *,
    demosaic: Demosaic = "menon",
    color_matrix: ArrayLike | None = None,
    digital_gain: float = 1.0,
    jpeg_quality: int | None = None,
) -> Developed:
    """Develop one exposure.

    Args:
        frame_or_dn: A frame, or its codes [h, w] (mosaic, monochrome) or [h, w, 3] (three chips).
        sensor: The camera it was taken with.
        demosaic: As in `develop_linear`.
        color_matrix: As in `develop_linear`.
        digital_gain: Factor on the linear values before anything is clipped to white; below 1, after.
        jpeg_quality: 1..100 puts `srgb8` through JPEG; None does not.

    Returns:
        `linear16`: code = 4096 + 61439 * linear, clipped to 0..65535, so 4096 is black, 65535 white and negative noise
        survives down to -6.7 % of white. `srgb8`: clip to 0..1, sRGB curve, 8 bits.

    Raises:
        ValueError: if the shape does not fit the sensor, or an option is out of range.
    """
    dn = np.asarray(getattr(frame_or_dn, "dn", frame_or_dn))
    require(digital_gain > 0, "digital_gain", "> 0", digital_gain)
    linear = develop_linear(dn, sensor, demosaic=demosaic, color_matrix=color_matrix)
    if digital_gain < 1:  # values that white balance lifts over white would stay coloured
        linear = np.minimum(linear, 1.0)
    linear = linear * np.float32(digital_gain)
    srgb8 = to_srgb8(linear)
    return Developed(to_linear16(linear), srgb8 if jpeg_quality is None else through_jpeg(srgb8, jpeg_quality))


def develop_linear(
    dn: ArrayLike, sensor: Sensor, *, demosaic: Demosaic = "menon", color_matrix: ArrayLike | None = None
) -> NDArray[np.float32]:
    """Codes -> white-balanced linear RGB; 1.0 is the white level, nothing is clipped.

    Every channel of a saturated pixel comes out at 1.0 or more, so clipping to 1.0 afterwards leaves no coloured
    highlights; before a colour matrix, which would colour them, values above 1.0 are clipped here. Takes codes or
    analytic means alike; below white linear in `dn`, but for "menon", which chooses directions.

    Args:
        dn: [h, w] or [h, w, 3], any real dtype, DN.
        sensor: Its black and white level, filter responses and pattern are used.
        demosaic: How the colour filter array is interpolated; "half" does not: each 2 x 2 cell becomes one pixel, its
            greens averaged, so noise stays independent between pixels and an odd last row or column is dropped.
        color_matrix: [3, 3] from white-balanced camera RGB to linear sRGB; None if the camera has the filters of sRGB
            times `rgb_response`, as for images made by `photons_for_electrons`.

    Returns:
        [h, w, 3] ([h//2, w//2, 3] for "half"), or [h, w] for a monochrome frame of a sensor without filter array.
    """
    dn = np.asarray(dn)
    fits = dn.ndim == 2 or (dn.ndim == 3 and dn.shape[2] == 3 and sensor.cfa is None)
    require(fits, "dn", "[h, w], or [h, w, 3] without colour filter array", dn.shape)
    linear = (dn.astype(np.float64) - sensor.black_level) / (sensor.white_dn - sensor.black_level)
    gains = white_balance(sensor)
    if sensor.cfa:
        linear = interpolate(linear * gains[channel_index(dn.shape, sensor.cfa)], sensor.cfa, demosaic)
    elif linear.ndim == 3:
        linear = linear * gains
    if color_matrix is not None:
        matrix = np.asarray(color_matrix, np.float64)
        require(matrix.shape == (3, 3) and linear.ndim == 3, "color_matrix", "[3, 3], for RGB only", matrix.shape)
        linear = np.minimum(linear, 1.0) @ matrix.T
    return linear.astype(np.float32)


def white_balance(sensor: Sensor) -> NDArray[np.float64]:
    """Factors for red, green, blue that make a white surface grey; the smallest is 1."""
    response = np.asarray(sensor.rgb_response)
    return response.max() / response


def interpolate(mosaic: NDArray, cfa: Cfa, demosaic: Demosaic) -> NDArray[np.float64]:
    """Demosaic [h, w] -> [h, w, 3], or one pixel per cell for "half"."""
    require(demosaic in DEMOSAIC, "demosaic", f"one of {DEMOSAIC}", demosaic)
    require(min(mosaic.shape) >= 2, "a frame with colour filter array", "at least 2 x 2", mosaic.shape)
    if demosaic == "half":
        h, w = (size - size % 2 for size in mosaic.shape)
        cells = mosaic[:h, :w].reshape(h // 2, 2, w // 2, 2).transpose(0, 2, 1, 3).reshape(h // 2, w // 2, 4)
        return np.stack([cells[..., [i for i, letter in enumerate(cfa) if letter == c]].mean(-1) for c in "RGB"], -1)
    functions = {"menon": menon, "malvar": malvar, "bilinear": bilinear}
    # Mirrored about its border pixels a mosaic keeps its pattern; what the three do at borders mixes the colours up
    padded = np.pad(mosaic, BORDER, mode="reflect")
    return functions[demosaic](padded, cfa)[BORDER:-BORDER, BORDER:-BORDER]


def through_jpeg(srgb8: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """An 8-bit picture after JPEG compression, [h, w] or [h, w, 3]."""
    try:
        import cv2  # slow to import and rarely needed
    except ImportError as error:  # the camera alone is installed
        raise ImportError("jpeg_quality needs OpenCV: pip install opencv-python-headless") from error

    require(1 <= quality <= 100, "jpeg_quality", "in 1..100", quality)
    swapped = srgb8[..., ::-1] if srgb8.ndim == 3 else srgb8  # OpenCV's channels run blue, green, red
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(swapped), [cv2.IMWRITE_JPEG_QUALITY, quality])
    back = np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))
    return np.ascontiguousarray(back[..., ::-1] if back.ndim == 3 else back)


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
