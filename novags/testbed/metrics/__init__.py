"""Scores: pure functions of arrays that compare what a method made with the truth.

`images` compares encoded pictures, `tone` aligns them first, `linear` compares light, `geometry` depth, `consistency`
one view with another, `noise` what is left of it; `perceptual` is LPIPS.
"""

from novags.testbed.metrics.consistency import ConsistencyScores, color_change, consistency_scores
from novags.testbed.metrics.geometry import GeometryScores, geometry_scores, opacity_in_front
from novags.testbed.metrics.images import (
    PSNR_CEILING,
    SSIM_WINDOW,
    ImageScores,
    aligned_psnr,
    delta_e,
    flip,
    gaussian_blur,
    image_scores,
    mean_scores,
    psnr,
    ssim,
)
from novags.testbed.metrics.linear import exposure_gain, is_black, linear_psnr
from novags.testbed.metrics.noise import centred_noise, noise_share, squared_bias
from novags.testbed.metrics.perceptual import PerceptualDistance
from novags.testbed.metrics.tone import Image, affine_aligned, tone_aligned

__all__ = [
    "PSNR_CEILING",
    "SSIM_WINDOW",
    "ConsistencyScores",
    "GeometryScores",
    "Image",
    "ImageScores",
    "PerceptualDistance",
    "affine_aligned",
    "aligned_psnr",
    "centred_noise",
    "color_change",
    "consistency_scores",
    "delta_e",
    "exposure_gain",
    "flip",
    "gaussian_blur",
    "geometry_scores",
    "image_scores",
    "is_black",
    "linear_psnr",
    "mean_scores",
    "noise_share",
    "opacity_in_front",
    "psnr",
    "squared_bias",
    "ssim",
    "tone_aligned",
]
