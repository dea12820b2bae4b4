"""How much of the known noise is left, and the part that no average of noisy pictures can remove.

The test bed knows the noise of each picture itself, not its variance alone: it is the picture less its noise-free twin
through the same enhancement. Images are float [h,w,3], sRGB-encoded.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from novags.testbed.metrics.picture import Image
from novags.testbed.metrics.tone import check_pair

LEVELS = 32  # of brightness, within each of which noise has the mean 0


def noise_share(image: Image, noisy: Image, reference: Image) -> float | None:
    """Share of the noise of `noisy` that is still in `image`: 1 for the noisy picture itself, 0 for the reference.

    The regression of the image's error on the known noise. The noise is centred at each brightness of the reference:
    clipping adds a bias to dark pixels that every exposure shares, not noise. Blur, a wrong tone and the noise of other
    exposures are uncorrelated with this noise, and so do not count.

    Returns:
        The share; None if `noisy` equals the reference, apart from its mean at each brightness.

    Raises:
        ValueError: If shapes differ or are not [h,w,3], or a value is not finite.
    """
    check_pair(image, reference)
    noise = centred_noise(noisy, reference)
    energy = float((noise * noise).sum())
    if energy == 0:
        return None
    return float((noise * (image.astype(np.float64) - reference)).sum()) / energy


def centred_noise(noisy: Image, reference: Image) -> NDArray[np.float64]:
    """The noise of a picture less its mean over the pixels of each of `LEVELS` levels of the reference, by channel.

    Levels hold equally many pixels; equal values of the reference may share two levels.
    """
    check_pair(noisy, reference)
    noise = noisy.astype(np.float64) - reference
    for c in range(3):
        plane = noise[..., c].ravel()
        for part in np.array_split(np.argsort(reference[..., c], axis=None, kind="stable"), LEVELS):
            if len(part):
                plane[part] -= plane[part].mean()
        noise[..., c] = plane.reshape(noise.shape[:2])
    return noise


def squared_bias(exposures: Sequence[Image], references: Sequence[Image]) -> float:
    """Mean squared difference between the mean of infinitely many exposures and the reference, estimated from a few.

    The square of the mean difference of K exposures, less their variance / K, over all pixels and channels. It scatters
    about the true value, so that for unbiased exposures it is below 0 about half the time.

    Args:
        exposures: K >= 2 pictures of one view that differ by noise.
        references: The noise-free twin of each, its reference.

    Raises:
        ValueError: If there are fewer than two, not as many of each, shapes differ, or a value is not finite.
    """
    if len(exposures) < 2 or len(references) != len(exposures):
        raise ValueError(
            f"a bias needs two exposures or more with a reference each, got {len(exposures)} and {len(references)}"
        )
    for pair in zip(exposures, references, strict=True):
        check_pair(*pair)
    errors = np.stack([e.astype(np.float64) - r for e, r in zip(exposures, references, strict=True)])
    return float((errors.mean(0) ** 2 - errors.var(0, ddof=1) / len(errors)).mean())
