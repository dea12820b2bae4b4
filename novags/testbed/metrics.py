"""Image metrics against a reference, plain and after an affine alignment.

Images are float32 [h,w,3], sRGB-encoded, 0..1. `aligned` removes what a choice of tone may change: per image and
channel, the gain and offset that bring the image closest to the reference in the least-squares sense. The fit sees the
image as it is; clipping to 0..1 comes after it.
"""

from typing import TypeAlias, TypedDict

import numpy as np
from scipy.ndimage import gaussian_filter

Image: TypeAlias = np.ndarray

SSIM_WINDOW = 11  # px; smaller images have no SSIM
PSNR_CEILING = 100.0  # dB; two identical images have no finite PSNR, and JSON has no infinity


class ImageScores(TypedDict):
    """Scores of one image against one reference; `lpips` is None where its weights are not on the machine."""

    psnr: float
    aligned_psnr: float
    ssim: float
    aligned_ssim: float
    flip: float
    lpips: float | None


def psnr(image: Image, reference: Image) -> float:
    """Peak signal-to-noise ratio for a peak of 1, in dB, at most `PSNR_CEILING`."""
    _same_shape(image, reference)
    mse = float(np.mean((image.astype(np.float64) - reference) ** 2))
    return PSNR_CEILING if mse <= 10 ** (-PSNR_CEILING / 10) else -10.0 * float(np.log10(mse))


def affine_aligned(image: Image, reference: Image) -> Image:
    """Per channel `a * image + b` closest to the reference (least squares), then clipped to 0..1.

    A channel without contrast carries no gain to fit: it becomes the reference's mean.
    """
    _same_shape(image, reference)
    aligned = np.empty_like(image, dtype=np.float32)
    for c in range(3):
        x, y = image[..., c].astype(np.float64), reference[..., c].astype(np.float64)
        variance = x.var()
        # Below this the variance is float32 rounding of a constant channel, and a gain from it would be noise.
        gain = 0.0 if variance < 1e-12 else ((x - x.mean()) * (y - y.mean())).mean() / variance
        aligned[..., c] = np.clip(gain * (x - x.mean()) + y.mean(), 0.0, 1.0)
    return aligned


def ssim(image: Image, reference: Image) -> float:
    """Structural similarity (11x11 Gaussian window, sigma 1.5, range 1), mean over pixels and channels.

    Raises:
        ValueError: If the images are smaller than the window.
    """
    import torch
    from torchmetrics.functional.image import structural_similarity_index_measure

    _same_shape(image, reference)
    if min(image.shape[:2]) < SSIM_WINDOW:
        size = f"{SSIM_WINDOW} x {SSIM_WINDOW} pixels"
        raise ValueError(f"SSIM needs images of at least {size}, got {image.shape[1]} x {image.shape[0]}")
    a, b = (
        torch.from_numpy(np.ascontiguousarray(x.transpose(2, 0, 1)[None], dtype=np.float32)) for x in (image, reference)
    )
    return float(structural_similarity_index_measure(a, b, data_range=1.0))


def flip(image: Image, reference: Image) -> float:
    """Mean FLIP (LDR, 67 pixels per degree): the difference seen when flipping between the two, 0 (none) to 1."""
    import flip_evaluator

    _same_shape(image, reference)
    ldr = [np.ascontiguousarray(np.clip(x, 0.0, 1.0), dtype=np.float32) for x in (reference, image)]
    return float(flip_evaluator.evaluate(*ldr, "LDR", applyMagma=False)[1])


def image_scores(image: Image, reference: Image, lpips: "PerceptualDistance | None" = None) -> ImageScores:
    """All scores of one image against one reference."""
    aligned = affine_aligned(image, reference)
    clipped = np.clip(image, 0.0, 1.0)
    return {
        "psnr": psnr(clipped, reference),
        "aligned_psnr": psnr(aligned, reference),
        "ssim": ssim(clipped, reference),
        "aligned_ssim": ssim(aligned, reference),
        "flip": flip(clipped, reference),
        "lpips": None if lpips is None else lpips(clipped, reference),
    }


def mean_scores(scores: list[ImageScores]) -> ImageScores:
    """Mean over views of each score; a score that no view has stays None."""
    if not scores:
        raise ValueError("there are no views to average")
    mean = {}
    for name in ImageScores.__annotations__:
        values = [s[name] for s in scores if s[name] is not None]  # type: ignore[literal-required]  # a loop
        mean[name] = float(np.mean(values)) if values else None
    return mean  # type: ignore[return-value]  # filled in a loop over all its keys


def gaussian_blur(image: Image, sigma: float) -> Image:
    """Gaussian blur of each channel; sigma in pixels."""
    return gaussian_filter(image, (sigma, sigma, 0.0), mode="reflect")


class PerceptualDistance:
    """LPIPS with the AlexNet backbone, if package and weights are on the machine; it never downloads."""

    HOW_TO_GET = (
        "install the extra (scripts/setup lpips) and, once with network access, run: "
        "python -c \"import lpips; lpips.LPIPS(net='alex')\""
    )

    def __init__(self) -> None:
        """Load the network.

        Raises:
            ValueError: If the package or its weights are missing; the message says how to get them.
        """
        if (missing := self.missing()) is not None:
            raise ValueError(missing)
        import lpips

        self._network = lpips.LPIPS(net="alex", verbose=False).eval()

    @classmethod
    def missing(cls) -> str | None:
        """Why LPIPS cannot be computed here and how to get it, or None if it can."""
        from importlib.util import find_spec
        from pathlib import Path

        if find_spec("lpips") is None:
            return f"the lpips package is not installed; {cls.HOW_TO_GET}"
        import torch

        if not list(Path(torch.hub.get_dir(), "checkpoints").glob("alexnet-*.pth")):
            return f"the AlexNet weights are not on this machine; {cls.HOW_TO_GET}"
        return None

    def __call__(self, image: Image, reference: Image) -> float:
        """Perceptual distance, 0 for equal images."""
        import torch

        a, b = (torch.from_numpy(x.transpose(2, 0, 1)[None].astype(np.float32) * 2 - 1) for x in (image, reference))
        with torch.no_grad():
            return float(self._network(a, b))


def _same_shape(image: Image, reference: Image) -> None:
    if image.shape != reference.shape or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(
            f"image and reference must both be [h, w, 3] of one size, got {image.shape} and {reference.shape}"
        )
