"""PSNR in linear light, for methods whose output is linear.

Images are float linear RGB [h,w,3] in any unit of light; `white` is the reference's value that a well-exposed picture
shows as white, and the peak of the PSNR. A method knows the exposure of its dark pictures, not the reference's: one
gain for the whole set bridges the two. A gain for each view would also forgive brightness that wavers between views.
"""

from collections.abc import Iterable

import numpy as np

from novags.testbed.metrics.images import PSNR_CEILING, psnr
from novags.testbed.metrics.picture import Image
from novags.testbed.metrics.tone import check_pair
from novags.testbed.metrics.truth import VARIANCE, Halves, named, squared_error, variance_of


def exposure_gain(pairs: Iterable[tuple[Image, Image]], white: float = 1.0) -> float:
    """The one factor on all images that minimises the squared error to their references over all views.

    Values where the reference has `white` or more do not count: a picture clips them, and a lamp in view would
    otherwise decide alone. Where nothing is darker, pixels at `white` itself do.

    Args:
        pairs: (image, reference) of each view; read once, so a generator needs memory for one view only.
        white: White of the references, in their unit.

    Raises:
        ValueError: If shapes differ, a value is not finite, or the sum of image times reference is not positive.
    """
    _check_positive("white", white)
    views, darker, up_to_white = 0, np.zeros(2), np.zeros(2)
    for image, reference in pairs:
        check_pair(image, reference)
        for sums, counts in ((darker, reference < white), (up_to_white, reference <= white)):
            x, y = image[counts].astype(np.float64), reference[counts].astype(np.float64)
            sums += x @ y, x @ x
        views += 1
    cross, energy = (float(each) for each in (darker if darker[0] > 0 else up_to_white))
    if not cross > 0:
        raise ValueError(
            f"the sum of image times reference must be > 0 to match exposures, got {cross:g} over {views} views: "
            "check that the images hold light, and show the same views as the references"
        )
    return cross / energy


def linear_psnr(image: Image, reference: Image, gain: float, white: float = 1.0) -> float:
    """PSNR in dB of `gain * image` against the reference for a peak of `white`.

    Both are clipped to 0..white after the gain, as pictures of the reference's exposure would be.

    Raises:
        ValueError: If the shapes differ, a value is not finite, or `gain` or `white` is not positive.
    """
    _check_positive("gain", gain)
    _check_positive("white", white)
    exposed, true = np.asarray(image, np.float64) * (gain / white), np.asarray(reference, np.float64) / white
    return psnr(np.clip(exposed, 0.0, 1.0), np.clip(true, 0.0, 1.0))


def linear_scores(
    image: Image, reference: Image, gain: float | None, halves: Halves | None = None
) -> dict[str, float | None]:
    """`linear_psnr` for a white of 1, None where no gain is known or the reference is black.

    With the two `halves` of a rendered truth: without its noise, and with the standard error, as `image_scores`.
    """
    gain = None if gain is None or is_black(reference) else gain
    if halves is None:
        return {"linear_psnr": None if gain is None else linear_psnr(image, reference, gain)}
    pair = [np.clip(light, 0.0, 1.0) for light in halves]
    variance = variance_of(*pair)
    found: tuple[float | None, float | None] = (None, None)
    if gain is not None:
        check_pair(image, reference)
        exposed, true = (np.clip(light, 0.0, 1.0) for light in (image * np.float32(gain), reference))
        found = squared_error(exposed, true, variance).decibels(PSNR_CEILING)
    return {**named("linear_psnr", found), VARIANCE: float(variance.mean())}


def is_black(reference: Image, white: float = 1.0) -> bool:
    """Whether PSNR cannot tell the reference from black, so that every gain towards 0 would reach its ceiling."""
    true = np.clip(np.asarray(reference, np.float64) / white, 0.0, 1.0)
    return psnr(np.zeros_like(true), true) >= PSNR_CEILING


def _check_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name} must be finite and > 0, got {value}")
