"""Alignments of an image to its reference, which remove differences of tone.

Images are float [h,w,3], sRGB-encoded. Both alignments work per image and channel, in the least-squares sense, and see
the unclipped image, values outside 0..1 included: clipping first would lose values that the fit brings back into range.

- `affine_aligned`: gain and offset.
- `tone_aligned`: any non-decreasing curve. It contains every affine change of positive gain, gamma and film curve.
"""

import numpy as np
from numpy.typing import NDArray

from novags.testbed.metrics.picture import Image

CONTRAST = 1 / 255  # sRGB code; a channel that spans less shows one colour on any 8-bit screen


def affine_aligned(image: Image, reference: Image) -> Image:
    """Per channel `a * image + b` closest to the reference (least squares), then clipped to 0..1; float32 [h,w,3].

    A channel without contrast carries no gain to fit: it becomes the reference's mean.

    Raises:
        ValueError: If the shapes differ or are not [h,w,3], or a value is not finite.
    """
    check_pair(image, reference)
    aligned = np.empty(image.shape, dtype=np.float32)
    for c in range(3):
        x, y = image[..., c].astype(np.float64), reference[..., c].astype(np.float64)
        variance = x.var()
        # Below this the variance is float32 rounding of a constant channel, and a gain from it would be noise.
        gain = 0.0 if variance < 1e-12 else ((x - x.mean()) * (y - y.mean())).mean() / variance
        aligned[..., c] = np.clip(gain * (x - x.mean()) + y.mean(), 0.0, 1.0)
    return aligned


def tone_aligned(image: Image, reference: Image) -> Image:
    """Per channel `f(image)` closest to the reference (least squares) over all non-decreasing curves `f`; float32.

    Isotonic regression of the reference's values on the image's (pool adjacent violators: Barlow, Bartholomew, Bremner
    and Brunk 1972), exact and without parameters. Equal values of the image share one output. The result consists of
    means of the reference's values, so it lies within the reference's range and needs no clipping; a constant channel
    becomes the reference's mean.

    It cannot see any increasing change of tone: too dark, too flat, a wrong gamma or white balance, and highlights or
    shadows crushed in steps finer than the noise cost nothing. Errors remain that no curve per channel can undo: noise,
    blur, displaced structure, colours mixed across channels, tones that differ from place to place. A curve has more
    freedom than a gain and an offset, so compare these scores with each other, never with affine-aligned ones.

    Raises:
        ValueError: If the shapes differ or are not [h,w,3], or a value is not finite.
    """
    check_pair(image, reference)
    channels = [_isotonic(image[..., c], reference[..., c]) for c in range(3)]
    return np.stack(channels, -1).astype(np.float32)


def _isotonic(x: Image, y: Image) -> Image:
    """Least-squares non-decreasing function of x [h,w] closest to y [h,w], at x, float64 [h,w]."""
    from scipy.optimize import isotonic_regression

    # Pooling order among equal values of x would give them different outputs, so each value enters once, as the
    # mean of its y weighted by how often it occurs.
    _, place, count = np.unique(x.ravel(), return_inverse=True, return_counts=True)
    place = place.ravel()
    means = np.bincount(place, weights=y.ravel().astype(np.float64)) / count
    return np.asarray(isotonic_regression(means, weights=count).x)[place].reshape(x.shape)


def with_contrast(reference: Image) -> NDArray[np.bool_]:
    """Which channels [3] of a reference [h,w,3] span at least `CONTRAST`.

    Both alignments turn a blank channel into the reference's mean. Where the reference itself is as good as blank, that
    is the truth: the noisiest picture scores like it, so an aligned score of such a channel says nothing.
    """
    return np.asarray(np.ptp(reference, axis=(0, 1)) >= CONTRAST)


def check_pair(image: Image, reference: Image) -> None:
    """Refuse images that cannot be compared.

    Raises:
        ValueError: If the shapes differ or are not [h,w,3], or a value is not finite.
    """
    if image.shape != reference.shape or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(
            f"image and reference must both be [h, w, 3] of one size, got {image.shape} and {reference.shape}"
        )
    for name, value in (("image", image), ("reference", reference)):
        # A nan would come out as a nan score at best, and as a sorted-last value of the tone curve at worst.
        if not np.isfinite(value).all():
            bad = int((~np.isfinite(value)).sum())
            raise ValueError(f"{name} must be finite to be scored, got {bad} values that are nan or infinite")
