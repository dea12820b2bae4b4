"""Raw frames as DNG files: a colour filter mosaic, or one or three full channels (LinearRaw).

Mosaics and monochrome frames are for any raw converter, three channels for LibRaw (rawpy) and programs built on it:
both levels are one number for all channels. DNG 1.4 asks for one a channel in such files, and Adobe's converters ignore
the levels that we write; but LibRaw takes three levels for three of its four channels, leaves the fourth at 0, and
renders the picture darker by black/white. No file suits both.

LibRaw reads all of them bit for bit, if both sides have `SMALLEST` pixels or more.
"""

from __future__ import annotations

import os
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sensor_model.files.atomic import atomic
from sensor_model.params import Exposure, Sensor, require

# CIE XYZ -> linear sRGB, D65 (IEC 61966-2-1): the channels are linear sRGB times the response of the filters.
XYZ_TO_SRGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])

SMALLEST = 22  # px, of either side: LibRaw takes smaller images for damaged files
TIMES = (1e-9, 2e9)  # s; range of a rational of the format, beside 0
BLACK_LEVEL = (50714, (5, 8))  # pidng's own has the type SHORT; RATIONAL (type 5, 8 bytes) takes fractions too


def write_dng(
    path: str | os.PathLike[str],
    dn: NDArray[np.uint16],
    sensor: Sensor,
    exposure: Exposure,
    *,
    color_matrix: ArrayLike | None = None,
) -> None:
    """Write the codes of one frame, bit for bit, with levels, pattern, white balance and colour matrix.

    Args:
        path: File to write; appears whole or not at all.
        dn: uint16, [h, w] for a mosaic or a monochrome sensor, [h, w, 3] for three chips. Below `SMALLEST` px the file
            is right, but LibRaw and programs built on it refuse it.
        sensor: The camera. A black level between two codes stays exact in the file; LibRaw rounds it.
        exposure: Its time goes into the file; 0, or within the range of the format, `TIMES`.
        color_matrix: As in `develop_linear`.

    Raises:
        ValueError: if the shape or dtype does not fit the sensor, or the time or the white level the file.
    """
    try:
        from pidng.core import RAW2DNG  # slow to import, and needed here only
    except ImportError as error:  # the camera alone is installed
        raise ImportError("a DNG needs the package pidng: pip install pidng") from error

    fits = dn.ndim == 2 or (dn.ndim == 3 and dn.shape[2] == 3 and sensor.cfa is None)
    require(fits, "dn", "[h, w], or [h, w, 3] without colour filter array", dn.shape)
    require(dn.dtype == np.uint16, "dn", "uint16", dn.dtype)
    holds = exposure.time == 0 or TIMES[0] <= exposure.time <= TIMES[1]
    require(holds, "time", f"0 or in {TIMES} s for a DNG", exposure.time)
    white = int(np.floor(sensor.white_dn))
    remedy = "raise gain or mu_e_sat: a full pixel must reach the next whole code"
    require(white > sensor.black_level, "white in a DNG", f"over black, {sensor.black_level:g} DN", white, remedy)
    converter = RAW2DNG()
    filters = np.eye(3) if color_matrix is None else np.linalg.inv(np.asarray(color_matrix, np.float64))
    converter.options(_tags(dn.shape, sensor, exposure, filters), path="", compress=False)
    data = converter.convert(np.ascontiguousarray(dn))
    with atomic(path) as temporary:
        temporary.write_bytes(data)


def _tags(shape: tuple[int, ...], sensor: Sensor, exposure: Exposure, filters: NDArray[np.float64]) -> Any:
    from pidng.core import DNGTags, Tag
    from pidng.defs import CalibrationIlluminant, CFAPattern, Orientation, PhotometricInterpretation

    channels = 1 if len(shape) == 2 else 3
    white = int(np.floor(sensor.white_dn))
    response = np.asarray(sensor.rgb_response)
    tags = DNGTags()
    for tag, value in (
        (Tag.ImageWidth, shape[1]),
        (Tag.ImageLength, shape[0]),
        (Tag.TileWidth, shape[1]),
        (Tag.TileLength, shape[0]),
        (Tag.Orientation, Orientation.Horizontal),
        (Tag.SamplesPerPixel, channels),
        (Tag.BitsPerSample, [16] * channels),
        (BLACK_LEVEL, _rationals(np.array([sensor.black_level]))),
        (Tag.WhiteLevel, [white]),
        (Tag.ExposureTime, _rationals(np.array([exposure.time]))),
        (Tag.Make, "novags"),
        (Tag.Model, "sensor_model"),
        (Tag.UniqueCameraModel, "novags sensor_model"),
        (Tag.PreviewColorSpace, 2),
    ):
        tags.set(tag, value)
    if sensor.cfa or channels == 3:
        tags.set(Tag.ColorMatrix1, _rationals(response[:, None] * (filters @ XYZ_TO_SRGB)))
        tags.set(Tag.CalibrationIlluminant1, CalibrationIlluminant.D65)
        tags.set(Tag.AsShotNeutral, _rationals(response / response.max()))
    if sensor.cfa:
        tags.set(Tag.PhotometricInterpretation, PhotometricInterpretation.Color_Filter_Array)
        tags.set(Tag.CFARepeatPatternDim, [2, 2])
        tags.set(Tag.CFAPattern, getattr(CFAPattern, sensor.cfa))
    else:
        tags.set(Tag.PhotometricInterpretation, PhotometricInterpretation.Linear_Raw)
    return tags


def _rationals(values: NDArray) -> list[list[int]]:
    """Numerators and denominators below 2**31, which both types of rational hold, signed and unsigned."""
    most = 2**31 - 1
    near = (Fraction(v).limit_denominator(int(most / max(abs(v), 1))) for v in map(float, values.ravel()))
    return [[fraction.numerator, fraction.denominator] for fraction in near]
