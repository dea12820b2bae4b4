"""Claims about the image metrics: analytic answers, invariances, and independent references."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torchmetrics.functional.image import structural_similarity_index_measure

from novags.testbed.metrics import METRICS, perceptual
from novags.testbed.metrics.images import (
    PSNR_CEILING,
    _ssim,  # of any number of channels
    delta_e,
    flip,
    gaussian_blur,
    image_scores,
    mean_scores,
    psnr,
    ssim,
)
from novags.testbed.metrics.tone import affine_aligned, tone_aligned


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


def test_lpips_of_images_too_small_for_its_network_is_refused_and_known_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The layers of AlexNet up to its second pooling; weights do not matter."""
    layers = (torch.nn.Conv2d(3, 1, 11, 4, 2), torch.nn.MaxPool2d(3, 2), torch.nn.MaxPool2d(3, 2))
    network = torch.nn.Sequential(*layers)
    monkeypatch.setattr(perceptual, "network", lambda: lambda a, b: (network(a) - network(b)).abs().mean())
    assert perceptual.lpips(picture(size=31), picture(size=31)) == 0.0
    with pytest.raises(ValueError, match="LPIPS needs images of at least 31 x 31 pixels, got 30 x 30"):
        perceptual.lpips(picture(size=30), picture(size=30))
    said = perceptual.missing(64, 24)
    assert said is not None
    assert said.endswith("got 64 x 24")


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


def test_an_affine_fit_is_clipped_to_what_a_picture_can_show() -> None:
    reference = np.clip(3 * picture() - 1, 0, 1)
    image = picture(1) + 0.5 * reference
    image[5, 6] = 9.0
    aligned = affine_aligned(image, reference)
    assert aligned.max() == 1.0
    assert aligned.min() >= 0.0


@pytest.mark.parametrize("shape", [(11, 11, 3), (11, 40, 3), (37, 23, 3), (16, 16, 1), (120, 90, 3)])
def test_ssim_equals_torchmetrics(shape: tuple[int, ...]) -> None:
    """In float64: in float32 it differs from itself, by up to 3e-5 where pictures are bright."""
    rng = np.random.default_rng(3)
    noise, other = rng.uniform(size=(2, *shape)).astype(np.float32)
    flat = np.full_like(noise, 0.3)
    near = np.clip(noise + rng.normal(0, 0.05, shape), 0, 1).astype(np.float32)
    pairs = [(noise, other), (near, noise), (0.02 * near, 0.02 * noise), (0.97 + 0.03 * near, 0.97 + 0.03 * noise),
             (flat, noise), (flat, 2 * flat), (flat, flat), (0 * flat, noise), (0 * flat, 0 * flat)]  # fmt: skip
    for image, reference in pairs:
        a, b = (torch.from_numpy(x.transpose(2, 0, 1)[None].astype(np.float64)) for x in (image, reference))
        theirs = float(structural_similarity_index_measure(a, b, data_range=1.0))
        assert _ssim(image, reference) == pytest.approx(theirs, abs=1e-10)


def test_flip_grows_with_the_error_and_stays_within_its_range() -> None:
    reference = picture()
    errors = [flip(np.clip(reference + np.float32(shift), 0, 1), reference) for shift in (0.02, 0.1, 0.3)]
    assert 0 < errors[0] < errors[1] < errors[2] <= 1


# Sharma, Wu and Dalal, "The CIEDE2000 color-difference formula" (2005), table 1: pairs that exercise every branch of
# the hue mean and difference, and the rotation term. Pair 14 is left out: it sits on a branch that rounding decides.
SHARMA = """
50 2.6772 -79.7751   50 0 -82.7485   2.0425
50 3.1571 -77.2803   50 0 -82.7485   2.8615
50 2.8361 -74.0200   50 0 -82.7485   3.4412
50 -1.3802 -84.2814  50 0 -82.7485   1.0000
50 -0.9009 -85.5211  50 0 -82.7485   1.0000
50 0 0               50 -1 2         2.3669
50 2.4900 -0.0010    50 -2.4900 0.0009   7.1792
50 2.4900 -0.0010    50 -2.4900 0.0011   7.2195
50 -0.0010 2.4900    50 0.0009 -2.4900   4.8045
50 2.5 0             50 0 -2.5       4.3065
50 2.5 0             73 25 -18      27.1492
50 2.5 0             61 -5 29       22.8977
50 2.5 0             56 -27 -3      31.9030
50 2.5 0             58 24 15       19.4535
50 2.5 0             50 3.1736 0.5854    1.0000
50 2.5 0             50 1.8634 0.5757    1.0000
60.2574 -34.0099 36.2677   60.4626 -34.1751 39.4387   1.2644
63.0109 -31.0961 -5.8663   62.8187 -29.7946 -4.0864   1.2630
61.2901 3.7196 -5.3901     61.4292 2.2480 -4.9620     1.8731
35.0831 -44.1164 3.7933    35.0232 -40.0716 1.5901    1.8645
22.7233 20.0904 -46.6940   23.0331 14.9730 -42.5619   2.0373
36.4612 47.8580 18.3852    36.2715 50.5065 21.2231    1.4146
90.8027 -2.0831 1.4410     91.1528 -1.6435 0.0447     1.4441
6.7747 -0.2908 -2.4247     5.8714 -0.0985 -2.2286     0.6377
2.0776 0.0795 -1.1350      0.9033 -0.0636 -0.5514     0.9082
"""


def test_the_operator_behind_delta_e_gives_sharmas_published_values() -> None:
    from skimage.color import deltaE_ciede2000

    a, b, published = np.split(np.array(SHARMA.split(), float).reshape(-1, 7), [3, 6], axis=1)
    assert np.abs(deltaE_ciede2000(a, b) - published[:, 0]).max() < 1e-4


def test_delta_e_agrees_with_the_colour_library() -> None:
    import colour

    image, reference = picture(1), picture(2) * np.float32((0.9, 1.0, 0.6))
    white = np.array((0.95047, 1.0, 1.08883))  # of IEC 61966-2-1, where grey has a* = b* = 0
    xy = white[:2] / white.sum()
    lab = [colour.XYZ_to_Lab(colour.sRGB_to_XYZ(x.astype(float)), xy) for x in (image, reference)]
    assert delta_e(image, reference) == pytest.approx(colour.delta_E(*lab, method="CIE 2000").mean(), rel=2e-3)


def test_delta_e_spans_0_to_100_and_clips_what_a_display_would_clip() -> None:
    black, white = np.zeros((4, 4, 3)), np.ones((4, 4, 3))
    assert delta_e(white, black) == pytest.approx(100.0, abs=1e-3)
    assert delta_e(white * 3, white) == 0.0
    assert delta_e(black - 0.2, black) == 0.0


def test_each_score_is_computed_from_the_picture_it_names(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = picture(3)
    # Overshoots 1 and 0, so that clipping before an alignment, or none at all, gives other numbers.
    image = 6.0 * (picture(3) ** 2 + 0.3 * picture(4)) - 2.0
    assert image.max() > 1.1
    assert image.min() < -0.1
    clipped, aligned, toned = np.clip(image, 0, 1), affine_aligned(image, reference), tone_aligned(image, reference)
    expected = {
        "psnr": psnr(clipped, reference), "aligned_psnr": psnr(aligned, reference),
        "tone_aligned_psnr": psnr(toned, reference), "ssim": ssim(clipped, reference),
        "aligned_ssim": ssim(aligned, reference), "tone_aligned_ssim": ssim(toned, reference),
        "flip": flip(clipped, reference), "delta_e": delta_e(clipped, reference), "lpips": 0.25,
    }  # fmt: skip
    given: list[np.ndarray] = []
    network = replace(METRICS["lpips"], score=lambda a, b: given.append(a) or 0.25)
    monkeypatch.setitem(METRICS, "lpips", network)
    scores = image_scores(image, reference, {"lpips"})
    assert {name: scores[name] for name in expected} == pytest.approx(expected)  # a later row has a test of its own
    assert len(set(scores.values())) == len(scores)
    assert np.array_equal(given[0], clipped)


def test_means_are_over_views_and_keep_what_is_missing_missing() -> None:
    scores = [image_scores(picture(k), picture(0)) for k in (1, 2)]
    mean = mean_scores(scores)
    assert mean["psnr"] == pytest.approx((scores[0]["psnr"] + scores[1]["psnr"]) / 2)
    assert mean["tone_aligned_psnr"] == pytest.approx(np.mean([s["tone_aligned_psnr"] for s in scores]))
    assert mean["lpips"] is None
    assert mean_scores([{"a": 1.0, "b": None}, {"a": 2.0, "b": 4.0}]) == {"a": 1.5, "b": 4.0}
    errors = [{"psnr": 30.0, "psnr_error": 0.3, "angular_error": angle} for angle in (3.0, 4.0, 8.0)]
    assert mean_scores(errors) == pytest.approx({"psnr": 30.0, "psnr_error": 0.3 / 3**0.5, "angular_error": 5.0})
    with pytest.raises(ValueError, match="no views to average"):
        mean_scores([])


def test_a_score_of_nan_is_refused_rather_than_given() -> None:
    broken = picture()
    broken[3, 4, 1] = np.nan
    with pytest.raises(ValueError, match="image must be finite to be scored, got 1 value"):
        image_scores(broken, picture())
    with pytest.raises(ValueError, match="reference must be finite"):
        image_scores(picture(), broken)


def test_images_of_another_size_are_refused() -> None:
    with pytest.raises(ValueError, match="of one size"):
        psnr(picture(0, 32), picture(0, 31))
    with pytest.raises(ValueError, match="11 x 11"):
        ssim(picture(0, 8), picture(0, 8))
