"""Claims about the image metrics: analytic answers, invariances, and independent references."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from novags.testbed.metrics import (
    PSNR_CEILING,
    affine_aligned,
    flip,
    gaussian_blur,
    image_scores,
    mean_scores,
    psnr,
    ssim,
)


def picture(seed: int = 0, size: int = 32) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return gaussian_blur(rng.uniform(0.2, 0.8, (size, size, 3)).astype(np.float32), 1.5)


def test_psnr_of_a_constant_error_is_analytic() -> None:
    image = picture()
    assert psnr(image + np.float32(0.1), image) == pytest.approx(20.0, abs=1e-4)


def test_equal_images_score_the_ceiling() -> None:
    scores = image_scores(picture(), picture())
    assert scores["psnr"] == PSNR_CEILING
    assert scores["ssim"] == pytest.approx(1.0, abs=1e-5)
    assert scores["flip"] == pytest.approx(0.0, abs=1e-6)
    assert scores["lpips"] is None


@settings(derandomize=True, deadline=None, max_examples=25)
@given(
    gain=st.lists(st.floats(0.3, 3.0), min_size=3, max_size=3),
    offset=st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3),
)
def test_alignment_undoes_any_gain_and_offset_per_channel(gain: tuple[float, ...], offset: tuple[float, ...]) -> None:
    reference = picture()
    changed = (reference - np.float32(offset)) / np.float32(gain)
    assert np.abs(affine_aligned(changed, reference) - reference).max() < 1e-4


def test_alignment_sees_values_beyond_the_range_before_clipping() -> None:
    reference = picture()
    assert psnr(affine_aligned(reference * 4, reference), reference) > 80


def test_alignment_is_the_least_squares_optimum() -> None:
    reference = picture(1)
    image = reference + np.random.default_rng(2).normal(0, 0.05, reference.shape).astype(np.float32)
    best = psnr(affine_aligned(image, reference), reference)
    for gain in (0.97, 1.03):
        for offset in (-0.01, 0.01):
            assert psnr(affine_aligned(image, reference) * gain + offset, reference) < best


def test_a_constant_image_aligns_to_the_mean() -> None:
    reference = picture()
    aligned = affine_aligned(np.full_like(reference, 0.3), reference)
    assert np.allclose(aligned, reference.mean((0, 1)), atol=1e-6)


def test_ssim_agrees_with_scikit_image() -> None:
    from skimage.metrics import structural_similarity

    reference = picture(0, 256)
    image = np.clip(reference + np.random.default_rng(3).normal(0, 0.05, reference.shape), 0, 1).astype(np.float32)
    options = {"channel_axis": 2, "data_range": 1.0, "gaussian_weights": True, "sigma": 1.5}
    _, theirs = structural_similarity(image, reference, use_sample_covariance=False, full=True, **options)
    assert ssim(image, reference) == pytest.approx(theirs.mean(), abs=2e-3)  # they mirror the border differently


def test_flip_grows_with_the_error_and_stays_within_its_range() -> None:
    reference = picture()
    errors = [flip(np.clip(reference + np.float32(shift), 0, 1), reference) for shift in (0.02, 0.1, 0.3)]
    assert 0 < errors[0] < errors[1] < errors[2] <= 1


def test_means_are_over_views_and_keep_what_is_missing_missing() -> None:
    scores = [image_scores(picture(k), picture(0)) for k in (1, 2)]
    mean = mean_scores(scores)
    assert mean["psnr"] == pytest.approx((scores[0]["psnr"] + scores[1]["psnr"]) / 2)
    assert mean["lpips"] is None


def test_images_of_another_size_are_refused() -> None:
    with pytest.raises(ValueError, match="of one size"):
        psnr(picture(0, 32), picture(0, 31))
    with pytest.raises(ValueError, match="11 x 11"):
        ssim(picture(0, 8), picture(0, 8))
