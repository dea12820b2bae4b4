"""Noise-level estimators against their definitions written out, and against noise of known strength."""

import math

import numpy as np
import pytest
import torch

from novags.methods.enhancers.noise_level import immerkaer_sigma, patch_pca_sigma


def picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 1, (3, height, width))


def pca_by_hand(image: np.ndarray, patch: int, stride: int) -> float:
    """Chen, Zhu, Heng 2015: the largest eigenvalues go until the mean of the rest is no more than its median."""
    _, height, width = image.shape
    patches = [
        image[:, y : y + patch, x : x + patch].ravel()
        for y in range(0, height - patch + 1, stride)
        for x in range(0, width - patch + 1, stride)
    ]
    values = np.sort(np.linalg.eigvalsh(np.cov(np.array(patches).T, bias=True)).clip(0))
    for count in range(len(values), 0, -1):
        if values[:count].mean() <= np.median(values[:count]):
            return math.sqrt(values[:count].mean())
    raise AssertionError("one value alone is its own median")


def test_immerkaer_is_his_sum():
    image = picture(6, 9)
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])
    total = 0.0
    for c, y, x in np.ndindex(3, 4, 7):
        total += abs((mask * image[c, y : y + 3, x : x + 3]).sum())
    expected = math.sqrt(math.pi / 2) * total / (6 * 3 * 4 * 7)
    assert float(immerkaer_sigma(torch.from_numpy(image))) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("size", "asked", "used"),
    [((40, 43), 8, 8), ((24, 30), 3, 3), ((12, 12), 8, 2), ((20, 9), 8, 3), ((36, 36), 8, 8), ((35, 34), 8, 7)],
)
def test_patch_pca_is_its_definition_with_patches_shrunk_to_four_per_dimension(size, asked, used):
    """Rationale: with a patch edge p there are 3 p² dimensions, so at least 12 p² patches are needed."""
    height, width = size
    fits = [p for p in range(1, asked + 1) if (height - p + 1) * (width - p + 1) >= 12 * p**2]
    assert max(fits) == used
    image = picture(*size)
    assert float(patch_pca_sigma(torch.from_numpy(image), patch=asked)) == pytest.approx(
        pca_by_hand(image, used, 1), rel=1e-6
    )


@pytest.mark.parametrize(("limit", "stride"), [(600, 1), (599, 2), (150, 2), (149, 3)])
def test_patches_lie_on_the_densest_grid_that_the_limit_allows(limit, stride):
    image = picture(26, 27)  # 24 x 25 places for a patch of 3
    found = patch_pca_sigma(torch.from_numpy(image), patch=3, max_patches=limit)
    assert float(found) == pytest.approx(pca_by_hand(image, 3, stride), rel=1e-6)


@pytest.mark.parametrize("estimate", [immerkaer_sigma, patch_pca_sigma])
def test_estimates_scale_with_the_noise_and_ignore_the_level(estimate):
    noise = np.random.default_rng(0).normal(0, 1, (3, 64, 64))
    for sigma, level in ((0.02, 0.3), (0.08, 0.6)):
        # 12,288 samples: 0.6 % of standard error; the tail's mean is biased by a few per cent
        assert float(estimate(torch.from_numpy(level + sigma * noise))) == pytest.approx(sigma, rel=0.08)


@pytest.mark.parametrize(("size", "known"), [((2, 9), False), ((9, 2), False), ((3, 3), True)])
def test_immerkaer_needs_three_pixels_each_way(size, known):
    found = immerkaer_sigma(torch.from_numpy(picture(*size)))
    assert found.dtype == torch.float64
    assert (float(found) > 0) == known


def test_the_default_patch_is_eight_pixels_and_twenty_thousand_patches_are_taken():
    image = torch.from_numpy(picture(48, 48))
    assert float(patch_pca_sigma(image)) == float(patch_pca_sigma(image, patch=8, max_patches=20_000))
    wide = torch.from_numpy(picture(8 + 99, 8 + 200))  # 100 x 201 places
    assert float(patch_pca_sigma(wide)) == float(patch_pca_sigma(wide, max_patches=5025))
