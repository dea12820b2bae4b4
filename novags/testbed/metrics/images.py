"""Image metrics against a reference, plain and after an alignment of tone.

Images are float [h,w,3], sRGB-encoded. Renders may overshoot 0..1 a little. `image_scores` fits the alignments to the
unclipped image; for all other scores, and after the affine fit, it is clipped to 0..1, as a display would.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from novags.numbers import SSIM_WINDOW
from novags.testbed.metrics import METRICS
from novags.testbed.metrics.metric import Metric
from novags.testbed.metrics.picture import Image
from novags.testbed.metrics.tone import affine_aligned, check_pair, tone_aligned, with_contrast
from novags.testbed.metrics.truth import BIAS, ERROR, VARIANCE, Halves, leverage, named, squared_error, variance_of
from sensor_model.files.outside import once
from sensor_model.files.reading import brief

PSNR_CEILING = 100.0  # dB; two identical images have no finite PSNR, and JSON has no infinity

Scores = TypeVar("Scores")  # a TypedDict of numbers or None


ImageScores = dict[str, float | None]
"""Scores of one image against one reference, by the names of `METRICS`.

A score by a network that was not requested is None. Aligned scores count only channels of the reference with contrast
(`with_contrast`); without such a channel they are None. Of a reference with known noise every PSNR has its standard
error beside it (`psnr_error`, dB), our other scores how far that noise has moved them (`ssim_bias`), and
`truth_variance` is the mean variance of the reference. A PSNR of which that noise leaves nothing is None, with an
infinite error.
"""


def psnr(image: Image, reference: Image) -> float:
    """Peak signal-to-noise ratio for a peak of 1, in dB, at most `PSNR_CEILING`."""
    check_pair(image, reference)
    return _psnr(image, reference)


def aligned_psnr(image: Image, reference: Image) -> float | None:
    """PSNR after the affine fit, over the channels in which the reference has contrast; None if none has.

    Raises:
        ValueError: If the shapes differ or are not [h,w,3], or a value is not finite.
    """
    return _over(with_contrast(reference), _psnr, affine_aligned(image, reference), reference)


def _psnr(image: Image, reference: Image) -> float:
    mse = float(np.mean((image.astype(np.float64) - reference) ** 2))
    return PSNR_CEILING if mse <= 10 ** (-PSNR_CEILING / 10) else -10.0 * float(np.log10(mse))


def ssim(image: Image, reference: Image) -> float:
    """Structural similarity (11x11 Gaussian window, sigma 1.5, range 1), mean over pixels and channels.

    Windows reach over the border into the mirrored picture, so that pixels near it count: numbers of torchmetrics.

    Raises:
        ValueError: If the images are smaller than the window.
    """
    check_pair(image, reference)
    return _ssim(image, reference)


def _ssim(image: Image, reference: Image) -> float:
    from skimage.metrics import structural_similarity

    if min(image.shape[:2]) < SSIM_WINDOW:
        size = f"{SSIM_WINDOW} x {SSIM_WINDOW} pixels"
        raise ValueError(f"SSIM needs images of at least {size}, got {image.shape[1]} x {image.shape[0]}")
    # Mirrored by as much as scikit-image leaves out of its mean. In float64, since the variance is a difference of
    # squares: float32 costs 3e-5 of a bright picture's score.
    beyond = (SSIM_WINDOW // 2, SSIM_WINDOW // 2)
    a, b = (np.pad(x.astype(np.float64), (beyond, beyond, (0, 0)), "reflect") for x in (image, reference))
    return float(
        structural_similarity(a, b, data_range=1.0, channel_axis=2, gaussian_weights=True, use_sample_covariance=False)
    )


def flip(image: Image, reference: Image) -> float:
    """Mean FLIP (LDR, 67 pixels per degree): the difference seen when flipping between the two, 0 (none) to 1."""
    import flip_evaluator

    check_pair(image, reference)
    ldr = [np.ascontiguousarray(np.clip(x, 0.0, 1.0), dtype=np.float32) for x in (reference, image)]
    return float(flip_evaluator.evaluate(*ldr, "LDR", applyMagma=False)[1])


def delta_e(image: Image, reference: Image) -> float:
    """Mean colour difference CIEDE2000 over all pixels (CIE 142-2001, k_L = k_C = k_H = 1), sRGB under D65; 0 if equal.

    About 1 is the smallest difference that an observer sees between uniform patches. Clipped to 0..1 first: sRGB has
    no colours beyond.
    """
    from skimage.color import deltaE_ciede2000, rgb2lab

    check_pair(image, reference)
    lab = [rgb2lab(np.clip(x, 0.0, 1.0).astype(np.float64)) for x in (image, reference)]
    return float(deltaE_ciede2000(*lab).mean())


ALIGNED_PSNR = Metric(
    heading="PSNR aligned",
    score=_psnr,
    more=True,
    unit="dB",
    digits=2,
    aligned="affine",
    in_studies=False,
    squared=True,
)
TONE_ALIGNED_PSNR = Metric(
    heading="PSNR tone-aligned", score=_psnr, more=True, unit="dB", digits=2, aligned="tone", squared=True
)
PSNR = Metric(heading="PSNR", score=psnr, more=True, unit="dB", digits=2, squared=True)
ALIGNED_SSIM = Metric(heading="SSIM aligned", score=_ssim, more=True, aligned="affine", in_studies=False)
TONE_ALIGNED_SSIM = Metric(heading="SSIM tone-aligned", score=_ssim, more=True, aligned="tone", in_studies=False)
SSIM = Metric(heading="SSIM", score=ssim, more=True)
FLIP = Metric(heading="FLIP", score=flip, more=False)
DELTA_E = Metric(heading="ΔE2000", score=delta_e, more=False, digits=2, in_studies=False)


def image_scores(
    image: Image, reference: Image, asked: Collection[str] = (), halves: Halves | None = None
) -> ImageScores:
    """All scores of one image against one reference in 0..1.

    Args:
        image: What was rendered; it may overshoot 0..1.
        reference: The truth.
        asked: Which of the scores by networks to compute, the others are None, and which of a data set's protocol,
            the others are left out.
        halves: The reference from each half of its samples, where it was rendered: its noise is taken out of every
            PSNR, and measured in our other scores. None: the reference counts as it is.

    Raises:
        ValueError: If the shapes differ, a value is not finite, or the images are smaller than the window of SSIM.
    """
    pictures = {
        "none": np.clip(image, 0.0, 1.0),
        "affine": affine_aligned(image, reference),
        "tone": tone_aligned(image, reference),
    }
    contrast = with_contrast(reference)
    found: ImageScores = {}
    for name, metric in METRICS.items():
        if metric.protocol and name not in asked:
            continue
        channels = np.ones(3, bool) if metric.aligned == "none" else contrast
        score = metric.score if METRICS.origin_of(name) is None else partial(_of_others, name)
        wanted = metric.missing is None or name in asked
        found[name] = _over(channels, score, pictures[metric.aligned], reference) if wanted else None
    if halves is None:
        return found
    against = [image_scores(image, half) for half in halves]
    biases = {name + BIAS: _bias(found[name], [half[name] for half in against]) for name in _unsquared()}
    return {**found, **_without_noise(pictures, reference, variance_of(*halves), contrast), **biases}


def _unsquared() -> list[str]:
    """Our scores of which the noise of the truth is measured and not taken out: not those by networks."""
    return [name for name, metric in METRICS.items() if not (metric.squared or metric.protocol)
            and metric.missing is None and METRICS.origin_of(name) is None]  # fmt: skip


def _bias(score: float | None, of_halves: Sequence[float | None]) -> float | None:
    known = [half for half in of_halves if half is not None]
    return None if score is None or len(known) < 2 else float(np.mean(known)) - score


def _without_noise(
    pictures: Mapping[str, Image], reference: Image, variance: NDArray[np.float64], contrast: NDArray[np.bool_]
) -> ImageScores:
    """Every PSNR without the noise of the reference, the standard errors, and the mean variance."""
    found: ImageScores = {}
    for name, metric in METRICS.items():
        if not metric.squared:
            continue
        image, kind = pictures[metric.aligned], metric.aligned
        chosen = np.ones(3, bool) if kind == "none" else contrast
        pair = (image[..., chosen], reference[..., chosen], variance[..., chosen])
        known = squared_error(*pair, leverage(pair[0], kind)).decibels(PSNR_CEILING) if chosen.any() else (None, None)
        found |= named(name, known)
    return {**found, VARIANCE: float(variance.mean())}


def _of_others(name: str, image: Image, reference: Image) -> float | None:
    """A score from outside; None where it fails, with a warning that names it: all other scores are kept."""
    try:
        found = float(METRICS[name].score(image, reference))
        if np.isfinite(found):
            return found
        why = f"it gave {found}"
    except Exception as error:  # a stranger's function may raise anything
        why = f"{type(error).__name__}: {brief(error, 200)}"
    once(f"the score {name} of {METRICS.origin_of(name)} cannot be computed ({why}); all other scores are")
    return None


def _over(
    channels: NDArray[np.bool_], score: Callable[[Image, Image], float | None], image: Image, reference: Image
) -> float | None:
    """The score over the selected channels; None if no channel is selected."""
    if channels.all():
        return score(image, reference)
    return score(image[..., channels], reference[..., channels]) if channels.any() else None


def mean_scores(scores: Sequence[Scores]) -> Scores:
    """Mean over views of each score of any of the score dictionaries; a score that no view has stays None.

    Standard errors by the truth's noise (`psnr_error` beside `psnr`) become that of the mean of the views that have the
    score, of which they are independent; infinite where none has.
    """
    if not scores:
        raise ValueError("there are no views to average")
    table: Any = scores  # TypedDicts share no type with their keys as variables
    values = {name: [view[name] for view in table if view[name] is not None] for name in table[0]}
    mean: Any = {name: float(np.mean(found)) if found else None for name, found in values.items()}
    for name in (name for name in mean if name.endswith(ERROR) and name.removesuffix(ERROR) in mean):
        known = [error for error in values[name] if np.isfinite(error)]
        mean[name] = float(np.linalg.norm(known)) / len(known) if known else max(values[name], default=None)
    return mean


def gaussian_blur(image: Image, sigma: float) -> Image:
    """Gaussian blur of each channel; sigma in pixels."""
    from scipy.ndimage import gaussian_filter  # a list of metrics imports this module, and computes nothing

    return gaussian_filter(image, (sigma, sigma, 0.0), mode="reflect")
