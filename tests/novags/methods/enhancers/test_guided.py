import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import EnhanceParams, box_mean, enhance, guided_filter
from novags.methods.enhancers.noise_level import immerkaer_sigma, patch_pca_sigma
from novags.methods.enhancers.pictures import solve_gamma
from sensor_model.isp import interpolate


def scene(height: int = 48, width: int = 40, level: float = 0.1) -> torch.Tensor:
    """A dark smooth image with one edge."""
    y, x = torch.meshgrid(torch.linspace(0, 1, height), torch.linspace(0, 1, width), indexing="ij")
    plane = level * (0.5 + 0.5 * y + (x > 0.5))
    return torch.stack([plane, 0.8 * plane, 0.6 * plane], -1)


def test_box_mean_of_ones_is_one_up_to_the_border():
    assert torch.allclose(box_mean(torch.ones(1, 2, 9, 7, dtype=torch.float64), 3), torch.ones(1, 2, 9, 7).double())


def test_guided_filter_equals_the_equations_written_out(smooth_by_hand):
    plane = np.random.default_rng(0).uniform(0, 0.2, (14, 11))
    found = guided_filter(torch.tensor(plane)[None, None], 3, torch.tensor([1e-3]))[0, 0]
    np.testing.assert_allclose(found.numpy(), smooth_by_hand(plane, 3, 1e-3), atol=1e-12)


def test_guided_filter_with_epsilon_zero_returns_the_image_and_with_a_huge_one_its_double_box_mean():
    image = torch.rand(1, 3, 20, 20, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    torch.testing.assert_close(guided_filter(image, 4, torch.tensor([0.0])), image)
    torch.testing.assert_close(guided_filter(image, 4, torch.tensor([1e9])), box_mean(box_mean(image, 4), 4))


@settings(derandomize=True, deadline=None, max_examples=25)
@given(level=st.floats(0.002, 0.95), target=st.floats(0.2, 0.8))
def test_gamma_brings_the_brightness_map_to_the_target(level, target):
    brightness = level * torch.linspace(0.2, 1, 1000, dtype=torch.float64)[None]
    config = EnhanceConfig(target=target, gamma_min=1e-3, gamma_max=100)
    assert abs(float((brightness ** solve_gamma(brightness, config)).mean()) - target) < 1e-6


def test_enhanced_noise_free_image_has_mean_exposure_near_the_target():
    enhanced, params = enhance(scene())
    assert abs(float(enhanced.mean()) - 0.5) < 0.02
    assert 0 < float(params.gamma) < 1


def test_a_batch_is_enhanced_image_by_image():
    batch = torch.stack([scene(level=0.05), scene(level=0.2)])
    together, params = enhance(batch)
    for i in range(2):
        alone, own = enhance(batch[i])
        torch.testing.assert_close(together[i], alone)
        assert float(params.gamma[i]) == pytest.approx(float(own.gamma))


def test_params_put_another_exposure_through_the_same_enhancement():
    clean = scene()
    noisy = (clean + 0.02 * torch.randn(clean.shape, generator=torch.Generator().manual_seed(0))).clamp(0, 1)
    _, params = enhance(noisy)
    twin, used = enhance(clean, params=params)
    assert used == EnhanceParams(gamma=params.gamma, epsilon=params.epsilon, radius=params.radius)
    # The twin differs from its own enhancement: that would use its own gamma and a smaller epsilon.
    assert not torch.allclose(twin, enhance(clean)[0], atol=1e-4)
    again, _ = enhance(noisy, params=params)
    torch.testing.assert_close(again, enhance(noisy)[0])


def test_black_images_stay_black_and_bright_ones_are_darkened():
    black, _ = enhance(torch.zeros(24, 24, 3))
    assert torch.equal(black, torch.zeros(24, 24, 3))
    bright = 0.7 + 0.2 * scene(level=0.5)
    darker, params = enhance(bright)
    assert float(params.gamma) > 1
    assert abs(float(darker.mean()) - 0.5) < 0.02
    white, _ = enhance(torch.ones(24, 24, 3))
    assert torch.isfinite(white).all()
    assert float(white.min()) > 0.99


def test_a_constant_image_becomes_the_target():
    enhanced, _ = enhance(torch.full((20, 30, 3), 0.05))
    # eta = 1e-4 in the denominator takes 0.2 % off at a level of 0.05.
    torch.testing.assert_close(enhanced, torch.full((20, 30, 3), 0.5), rtol=3e-3, atol=0)


@pytest.mark.parametrize("shape", [(1, 1, 3), (2, 3, 3), (5, 40, 3), (33, 33, 3)])
def test_images_smaller_than_the_window_shrink_it(shape):
    enhanced, params = enhance(0.1 * torch.rand(shape, generator=torch.Generator().manual_seed(0)))
    assert enhanced.shape == shape
    assert torch.isfinite(enhanced).all()
    assert 2 * params.radius + 1 <= min(shape[:2])


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -0.01, 1.01])
def test_values_that_are_no_image_are_refused(bad):
    dark = scene()
    dark[3, 4, 1] = bad
    with pytest.raises(ValueError, match=r"finite and in 0..1.*\(3, 4, 1\)"):
        enhance(dark)


@pytest.mark.parametrize("dark", [torch.zeros(4, 4), torch.zeros(3, 4, 4), torch.zeros(4, 4, 3, dtype=torch.uint8)])
def test_arrays_of_another_shape_or_dtype_are_refused(dark):
    with pytest.raises(ValueError, match="float image"):
        enhance(dark)


def test_params_of_another_number_of_images_are_refused():
    _, params = enhance(torch.stack([scene()] * 3))
    with pytest.raises(ValueError, match="params hold"):
        enhance(scene(), params=params)


def test_gradients_match_finite_differences():
    dark = 0.05 + 0.1 * torch.rand(7, 7, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    _, params = enhance(dark)
    assert torch.autograd.gradcheck(
        lambda image: enhance(image, params=params)[0], dark.requires_grad_(), eps=1e-7, atol=1e-4
    )


def test_gradients_stay_finite_on_black_pixels():
    dark = scene()
    dark[:10] = 0
    dark.requires_grad_()
    enhance(dark)[0].sum().backward()
    assert torch.isfinite(dark.grad).all()


@pytest.mark.parametrize("sigma", [0.01, 0.05])
def test_both_estimators_recover_white_noise_on_a_smooth_image(sigma):
    clean = scene(128, 128).movedim(-1, 0)
    noisy = clean + sigma * torch.randn(clean.shape, generator=torch.Generator().manual_seed(2))
    # 49,152 samples: the relative standard error of a standard deviation is 0.3 %; the rest is the estimators' bias.
    assert float(immerkaer_sigma(noisy)) == pytest.approx(sigma, rel=0.1)
    assert float(patch_pca_sigma(noisy)) == pytest.approx(sigma, rel=0.05)


def test_immerkaer_is_far_too_low_on_demosaiced_noise():
    noise = np.random.default_rng(0).normal(0.5, 0.05, (128, 128))
    demosaiced = torch.from_numpy(interpolate(noise, "RGGB", "bilinear")).movedim(-1, 0)
    assert float(immerkaer_sigma(demosaiced)) < 0.5 * float(demosaiced.std(dim=(1, 2)).mean())


def test_patch_pca_is_less_misled_by_texture_than_immerkaer():
    stripes = 0.1 * torch.sin(2.0 * torch.arange(128))
    clean = (0.5 + stripes[:, None] * stripes.sign()).expand(3, 128, 128)
    noisy = clean + 0.03 * torch.randn(clean.shape, generator=torch.Generator().manual_seed(3))
    checker = noisy + 0.2 * stripes[:, None] * stripes.sign()
    assert abs(float(patch_pca_sigma(checker)) - 0.03) < 0.003
    assert abs(float(immerkaer_sigma(checker)) - 0.03) > 0.003


@pytest.mark.parametrize("estimate", [immerkaer_sigma, patch_pca_sigma])
@pytest.mark.parametrize("size", [1, 2, 5])
def test_estimators_are_defined_on_tiny_and_constant_images(estimate, size):
    assert float(estimate(torch.full((3, size, size), 0.3))) == pytest.approx(0, abs=1e-7)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"window": 4}, "window must be odd and >= 1 px, got 4"),
        ({"target": 1.0}, r"target must lie in \(0, 1\), got 1.0"),
        ({"eta": 0.0}, "eta must be > 0 .* got 0.0"),
        ({"noise_factor": -1.0}, "noise_factor must be finite and >= 0, got -1.0"),
        ({"noise_factor": float("nan")}, "noise_factor must be finite and >= 0, got nan"),
        ({"noise_estimator": "patch_pca"}, "must be one of patch-pca, immerkaer, camera, got 'patch_pca'"),
        ({"guide": "channels"}, "guide must be one of channel, luminance, got 'channels'"),
        ({"gamma_min": 2.0, "gamma_max": 1.0}, "need 0 < gamma_min < gamma_max, got 2.0 and 1.0"),
    ],
)
def test_impossible_configurations_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        EnhanceConfig(**wrong)
