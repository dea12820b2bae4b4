"""Hard cases of the scores: equal and blank pictures, fits without contrast, masks, nan.

References: closed forms, and the definitions written out in float64 (SSIM with a variance in two passes, the isotonic
curve as its min-max formula).
"""

import math
import sys
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torchmetrics.functional.image import structural_similarity_index_measure

from novags.testbed.metrics import images, tone
from novags.testbed.metrics.consistency import consistency_scores
from novags.testbed.metrics.geometry import geometry_scores
from novags.testbed.metrics.images import PSNR_CEILING, delta_e, flip, image_scores, psnr, ssim
from novags.testbed.metrics.linear import exposure_gain, linear_psnr
from novags.testbed.metrics.tone import affine_aligned, tone_aligned
from tests.stability.case import EPS, Case, Error, Fails, Part, Setting, refusal, worse

PART = Part("score")
HERE = sys.modules[__name__]  # where the cases find what a test replaces


def noise(low: float = 0.0, high: float = 1.0, seed: int = 0, size: int = 16) -> NDArray[np.float32]:
    """A picture [size, size, 3] of uniform noise."""
    return np.random.default_rng(seed).uniform(low, high, (size, size, 3)).astype(np.float32)


def flat(level: float, size: int = 16) -> NDArray[np.float32]:
    """A picture of one colour."""
    return np.full((size, size, 3), level, np.float32)


def spot() -> NDArray[np.float32]:
    """Black but for one white pixel."""
    picture = flat(0.0)
    picture[5, 7] = 1.0
    return picture


@PART.case("equal pictures, noisy, blank or of one pixel: the best score", bound=4 * EPS, unit="score",
           backends=("numpy",))  # fmt: skip
def _(setting: Setting) -> float:
    worst = 0.0
    for picture in (noise(), flat(0.0), flat(0.5), flat(1.0), spot()):
        off = (psnr(picture, picture) - PSNR_CEILING, ssim(picture, picture) - 1, flip(picture, picture))
        worst = worse(worst, *map(abs, off), delta_e(picture, picture))
    return worst


@PART.case("PSNR of errors of 1, 1e-3, 1.0001e-5 and 1e-30", bound=1e-9, unit="dB", backends=("numpy",))
def _(setting: Setting) -> float:
    black = np.zeros((16, 16, 3))
    found = [abs(psnr(black + error, black) + 20 * math.log10(error)) for error in (1.0, 1e-3, 1.0001e-5)]
    return worse(*found, abs(psnr(black + 1e-30, black) - PSNR_CEILING))


def _ssim(a: NDArray, b: NDArray) -> float:
    """Wang et al. (2004), eq. 13, of mirrored pictures, with the squares taken about the local means."""
    a, b = (np.pad(x, ((5, 5), (5, 5), (0, 0)), "reflect") for x in (a, b))
    at = np.arange(-5, 6)
    line = np.exp(-0.5 * (at / 1.5) ** 2)
    line /= line.sum()
    values = []
    for c in range(3):
        x, y = a[..., c].astype(np.float64), b[..., c].astype(np.float64)
        for i in range(5, x.shape[0] - 5):
            for j in range(5, x.shape[1] - 5):
                weights = line[:, None] * line[None]
                p, q = x[i - 5 : i + 6, j - 5 : j + 6], y[i - 5 : i + 6, j - 5 : j + 6]
                m, n = (weights * p).sum(), (weights * q).sum()
                vp, vq = (weights * (p - m) ** 2).sum(), (weights * (q - n) ** 2).sum()
                both = (weights * (p - m) * (q - n)).sum()
                values.append((2 * m * n + 1e-4) * (2 * both + 9e-4) / ((m * m + n * n + 1e-4) * (vp + vq + 9e-4)))
    return math.fsum(values) / len(values)


# E[x**2] - E[x]**2 near white is wrong by some 1e-16, beside the constant 9e-4: in float32 by 1e-3 at the worst pixel.
@PART.case("SSIM of blank against nearly blank, at black, grey and white", bound=1e-11, unit="SSIM",
           backends=("numpy",))  # fmt: skip
def _(setting: Setting) -> float:
    worst = 0.0
    for level in (0.0, 0.5, 0.999):
        for spread in (0.0, 1e-4, 1e-3):
            a, b = flat(level), noise(level, level + spread, seed=1)
            worst = worse(worst, abs(ssim(a, b) - _ssim(a, b)), abs(ssim(b, a) - _ssim(b, a)))
    return worst


@PART.case("affine fit of a blank picture: the mean of the reference", bound=EPS, unit="of white", backends=("numpy",))
def _(setting: Setting) -> float:
    reference = noise(seed=2)
    mean = reference.astype(np.float64).mean((0, 1))
    rounded = (flat(0.7).astype(np.float64) + 1e-9 * noise(seed=3)).astype(np.float32)  # one rounding apart at most
    return worse(*(float(np.abs(affine_aligned(x, reference) - mean).max()) for x in (flat(0.0), flat(0.7), rounded)))


@PART.case(
    "affine fit of a contrast of 1e-4, with an offset of 1e4", bound=2 * EPS, unit="of white", backends=("numpy",)
)
def _(setting: Setting) -> float:
    """The fit undoes the change as far as its digits go: 1e4 in float64 leaves 1e4 * 2e-16 / 1e-4 = 2e-8."""
    reference = noise(0.2, 0.8, seed=4).astype(np.float64)
    found = [affine_aligned(1e-4 * reference + offset, reference) - reference for offset in (0.0, 0.5, 1e4)]
    return worse(*(float(np.abs(error).max()) for error in found))


def _isotonic(x: NDArray, y: NDArray) -> NDArray:
    """Barlow et al. (1972): the largest, over where a run begins, of the smallest mean of a run that reaches here."""
    levels = np.unique(x)
    sums = np.array([math.fsum(y[x == level]) for level in levels])
    counts = np.array([float((x == level).sum()) for level in levels])
    curve = [
        max(min(sums[a : b + 1].sum() / counts[a : b + 1].sum() for b in range(i, len(levels))) for a in range(i + 1))
        for i in range(len(levels))
    ]
    return np.asarray(curve)[np.searchsorted(levels, x)]


@PART.case("monotone curve of blank, two-valued, falling and nearly equal values", bound=EPS, unit="of white",
           backends=("numpy",))  # fmt: skip
def _(setting: Setting) -> float:
    reference = noise(seed=5, size=6)
    halves = (noise(seed=6, size=6) > 0.5).astype(np.float32)
    close = (0.5 + EPS * np.floor(8 * noise(seed=7, size=6))).astype(np.float32)
    worst = 0.0
    for picture in (flat(0.4, 6), halves, 1 - reference, close, noise(seed=8, size=6)):
        found = tone_aligned(picture, reference)
        for c in range(3):
            wanted = _isotonic(picture[..., c].ravel(), reference[..., c].ravel())
            worst = worse(worst, float(np.abs(found[..., c].ravel() - wanted).max()))
    return worst


@PART.case("a blank reference: null as aligned score, not the ceiling", bound=0, unit="scores given",
           backends=("numpy",))  # fmt: skip
def _(setting: Setting) -> float:
    worst = 0.0
    for reference in (flat(0.0), flat(0.5), noise(0.5, 0.5 + 0.9 / 255)):
        scores = image_scores(noise(seed=9), reference)
        worst = worse(worst, sum(score is not None for name, score in scores.items() if "aligned" in name))
    return float(worst)


@PART.case("one channel without contrast: as if it were not there", bound=1e-6, unit="dB", backends=("numpy",))
def _(setting: Setting) -> float:
    reference, picture = noise(seed=10), noise(seed=11)
    reference[..., 1] = 0.25
    residual = (affine_aligned(picture, reference).astype(np.float64) - reference)[..., [0, 2]]
    found = image_scores(picture, reference)["aligned_psnr"]
    return math.inf if found is None else abs(found + 10 * math.log10(float((residual**2).mean())))


@PART.case("nan and infinite pixels: refused with their count", bound=0, unit="refused", backends=("numpy",))
def _(setting: Setting) -> float:
    worst = 0.0
    for bad in (math.nan, math.inf, -math.inf):
        broken, whole = noise(seed=12), noise(seed=13)
        broken[0, 0, 0] = broken[3, 4, 1] = bad
        worst = worse(
            worst,
            refusal(lambda a=broken, b=whole: image_scores(a, b), "image must be finite", "2 values"),
            refusal(lambda a=whole, b=broken: image_scores(a, b), "reference must be finite"),
            refusal(lambda a=whole, b=broken: exposure_gain([(a, b)]), "reference must be finite"),
        )
    return worst


@PART.case("linear light from 1e-8 to 1e8, with a lamp in view: the gain", bound=1e-6, unit="relative",
           backends=("numpy",))  # fmt: skip
def _(setting: Setting) -> float:
    reference = noise(0.01, 1.0, seed=14)
    reference[2, 3] = 1e8
    worst = 0.0
    for unit in (1e-8, 1.0, 1e8):
        picture = (reference * np.float32(unit)).astype(np.float32)
        picture[2, 3] = unit  # what a method makes of a lamp is free
        gain = exposure_gain([(picture, reference)])
        worst = worse(worst, abs(gain * unit - 1), abs(linear_psnr(flat(unit), flat(1.0), 0.9 / unit) - 20))
    return worst


@PART.case("pixels that nobody sees, of depth 0, infinite or nan: left out", bound=0, unit="scores differ",
           backends=("numpy",))  # fmt: skip
def _(setting: Setting) -> float:
    a, b = noise(seed=15), noise(seed=16)
    nowhere, hidden = np.full((16, 16, 2), np.nan), np.zeros((16, 16), bool)
    seen, flow = hidden.copy(), nowhere.copy()
    seen[4:9, 2:11], flow[4:9, 2:11] = True, 0.0
    wrong = sum(v is not None for v in consistency_scores((a, b), (a, b), nowhere, hidden).values())
    part = consistency_scores((a, b), (b, a), flow, seen)["rendered"]
    wrong += part != float(np.abs(b.astype(np.float64) - a)[seen].mean())
    truth, depth = np.full((16, 16), np.inf), np.full((16, 16), 2.0)
    truth[0, 0], truth[0, 1], truth[5:8, 5:8], depth[6, 6] = 0.0, np.nan, 2.0, np.nan
    scores = geometry_scores(depth, np.ones((16, 16)), truth)
    wrong += scores != {"abs_rel": 0.0, "within_5_percent": 8 / 9, "coverage": 8 / 9, "floaters": 0.0}
    wrong += set(geometry_scores(depth, np.ones((16, 16)), np.full((16, 16), np.inf)).values()) != {None}
    return float(wrong)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def without_ceiling(image: Any, reference: Any) -> float:
    with np.errstate(divide="ignore"):
        return float(-10 * np.log10(np.mean((image - reference) ** 2)))


def ssim_over_the_range_of_the_pictures(image: Any, reference: Any) -> float:
    a, b = (torch.from_numpy(x.transpose(2, 0, 1)[None].copy()) for x in (image, reference))
    return float(structural_similarity_index_measure(a, b))


def fitted_whatever_the_contrast(image: Any, reference: Any) -> Any:
    with np.errstate(all="ignore"):
        x, y = image.reshape(-1, 3), reference.reshape(-1, 3)
        gain = ((x * y).mean(0) - x.mean(0) * y.mean(0)) / ((x * x).mean(0) - x.mean(0) ** 2)
        return gain * (image - x.mean(0)) + y.mean(0)


def sorted_curve(image: Any, reference: Any) -> Any:
    """Isotonic regression in the order of a sort, which splits equal values."""
    from scipy.optimize import isotonic_regression

    out = np.empty(image.shape)
    for c in range(3):
        order = np.argsort(image[..., c].ravel(), kind="stable")
        plane = np.empty(order.size)
        plane[order] = isotonic_regression(reference[..., c].ravel()[order].astype(float)).x
        out[..., c] = plane.reshape(image.shape[:2])
    return out


def every_pixel(depth: Any, alpha: Any, truth: Any) -> dict[str, float]:
    with np.errstate(all="ignore"):
        error = np.abs(depth / truth - 1)
    return {"abs_rel": float(error.mean()), "within_5_percent": 1.0, "coverage": 1.0, "floaters": 0.0}


@pytest.mark.parametrize(
    ("module", "name", "naive", "start"),
    [
        (images, "_psnr", without_ceiling, "equal pictures"),
        (images, "_psnr", without_ceiling, "PSNR of errors"),
        (images, "_ssim", ssim_over_the_range_of_the_pictures, "SSIM of blank"),
        (HERE, "affine_aligned", fitted_whatever_the_contrast, "affine fit of a blank"),
        (HERE, "affine_aligned", fitted_whatever_the_contrast, "affine fit of a contrast"),
        (HERE, "tone_aligned", sorted_curve, "monotone curve"),
        (images, "with_contrast", lambda reference: np.ones(3, bool), "a blank reference"),
        (images, "with_contrast", lambda reference: np.ones(3, bool), "one channel"),
        (tone, "np", None, "nan and infinite"),
        (HERE, "exposure_gain", lambda pairs: float((pairs[0][0] * pairs[0][1]).sum() / (pairs[0][0] ** 2).sum()),
         "linear light"),
        (HERE, "geometry_scores", every_pixel, "pixels that nobody sees"),
    ],
)  # fmt: skip
def test_a_score_as_first_written_exceeds_its_bound(
    module: Any, name: str, naive: Any, start: str, fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not fails(start)
    if name == "np":  # the check for NaN and infinity, taken out wherever it was imported
        for user in (tone, images):
            monkeypatch.setattr(user, "check_pair", lambda image, reference: None)
    else:
        monkeypatch.setattr(module, name, naive)
    with np.errstate(all="ignore"):
        assert fails(start)
