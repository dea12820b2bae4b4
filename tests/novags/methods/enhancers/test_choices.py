"""What the paper leaves open of the enhancement: the guide, the known noise as epsilon, and no enhancement at all."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.optimize import brentq

from novags.methods.enhancers import enhancement_record, recorded
from novags.methods.enhancers.applying import enhanced, enhanced_clean, enhanced_twin, enhanced_view
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import enhance
from novags.methods.enhancers.noise_level import immerkaer_sigma, known_sigma, patch_pca_sigma
from novags.methods.inputs import LacksInput
from novags.methods.memo import Memo
from novags.methods.noise import Noise, Variance
from novags.methods.nova.config import NovaConfig
from novags.methods.problem import Problem
from novags.settings import changed
from novags.splats import Views
from sensor_model import NoiseCurve, linear_to_srgb
from sensor_model.isp import interpolate

Y = (0.2126, 0.7152, 0.0722)


def variance(offset=(1e-4, 2e-4, 3e-4), slope=(0.002, 0.001, 0.004)) -> Variance:
    zero, one, never = (0.0,) * 3, (1.0,) * 3, (float("inf"),) * 3
    return Variance(
        NoiseCurve(black=zero, white=one, offset=offset, slope=slope, quadratic=zero, switch=never, step=zero)
    )


def textured() -> np.ndarray:
    rng = np.random.default_rng(0)
    image = rng.uniform(0.2, 1, (13, 18, 3)) * (0.25, 0.1, 0.15)
    image[3, 4], image[8, 11] = 0.9, 0.0
    return image


def test_the_luminance_guide_makes_one_brightness_map_for_all_channels(smooth_by_hand):
    dark = textured()
    config = EnhanceConfig(guide="luminance", window=7, eta=0.01, bisection_steps=60)
    found, params = enhance(torch.from_numpy(dark), config)
    luminance = dark @ np.array(Y)
    epsilon = float(patch_pca_sigma(torch.from_numpy(luminance)[None])) ** 2
    assert float(params.epsilon) == pytest.approx(epsilon, rel=1e-9)
    L = smooth_by_hand(luminance, 3, epsilon)
    bounded = np.maximum(L, 0.01)
    gamma = brentq(lambda g: (bounded**g).mean() - 0.5, 0.02, 5.0, xtol=1e-13)
    expected = np.minimum(dark * (bounded**gamma / (L + 0.01))[..., None], 1)
    assert float(params.gamma) == pytest.approx(gamma, rel=1e-9)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)


def test_a_twin_goes_through_the_luminance_map_of_its_own_with_the_same_parameters():
    dark = torch.from_numpy(textured())
    config = EnhanceConfig(guide="luminance", window=7)
    found, params = enhance(dark, config)
    assert torch.equal(enhance(dark, config, params)[0], found)


@pytest.mark.parametrize("weights", [None, Y])
def test_known_noise_is_the_variance_at_the_light_around_times_the_slope_squared(window, weights):
    code, noise = textured(), variance()
    total = []
    for y, x in np.ndindex(code.shape[:2]):
        mean = window(code, y, x, 2).mean((0, 1))
        each = []
        for c in range(3):
            linear = brentq(lambda v, m=mean[c]: float(linear_to_srgb(v)) - m, 0, 1, xtol=1e-15)
            step = 1e-7
            slope = float(linear_to_srgb(linear + step) - linear_to_srgb(linear)) / step
            each.append((noise.curve.offset[c] + noise.curve.slope[c] * linear) * slope**2)
        total.append(np.mean(each) if weights is None else np.dot(np.square(weights), each))
    found = known_sigma(torch.from_numpy(code).movedim(-1, 0), noise, weights)
    assert float(found) == pytest.approx(np.sqrt(np.mean(total)), rel=1e-4)


def test_known_noise_is_what_many_exposures_scatter_by():
    rng = np.random.default_rng(0)
    linear, noise = np.full((96, 96, 3), 0.08), variance((1e-5,) * 3, (1e-3,) * 3)
    exposed = linear + rng.normal(0, np.sqrt(1e-5 + 1e-3 * linear))
    code = torch.from_numpy(linear_to_srgb(np.clip(exposed, 0, 1)).astype(np.float32)).movedim(-1, 0)
    scatter = float(code.std())
    assert float(known_sigma(code, noise)) == pytest.approx(scatter, rel=0.05)
    assert float(known_sigma(code, noise, Y)) == pytest.approx(scatter * np.linalg.norm(Y), rel=0.05)


def test_epsilon_can_be_the_known_variance_where_estimates_collapse():
    """Rationale: demosaicing leaves smooth noise, which estimators of white noise take for a picture."""
    rng = np.random.default_rng(1)
    mosaic = 0.15 + 0.03 * rng.standard_normal((64, 64))
    linear = interpolate(mosaic, "RGGB", "bilinear").clip(0, 1)
    dark = torch.from_numpy(linear_to_srgb(linear))
    known = variance(tuple(linear.var((0, 1))), (0.0,) * 3)
    true = float(dark.var((0, 1)).mean())
    _, params = enhance(dark, EnhanceConfig(noise_estimator="camera", noise_factor=2.0), noise=known)
    assert float(params.epsilon) == pytest.approx(2 * true, rel=0.1)
    assert float(immerkaer_sigma(dark.movedim(-1, 0))) ** 2 < 0.4 * true


def test_known_noise_that_is_not_known_is_refused():
    with pytest.raises(LacksInput, match="noise_estimator = camera needs the noise of the camera, known or estimated"):
        enhance(torch.from_numpy(textured()), EnhanceConfig(noise_estimator="camera"))


def test_the_noise_of_the_capture_reaches_the_enhancement_of_a_view_and_of_its_twin():
    dark = torch.from_numpy(textured()).float()
    config, noise = EnhanceConfig(noise_estimator="camera"), Noise(variance(), None, "camera")
    expected, params = enhance(dark, config, noise=variance())
    assert torch.equal(enhanced_view(Memo(), "a", dark, config, "8bit", noise)[0], expected)
    twin = enhanced_twin(Memo(), "a", dark, 0.9 * dark, config, "8bit", noise)
    assert torch.equal(twin, enhance(0.9 * dark, config, params)[0])


def test_without_enhancement_pictures_and_references_stay_as_they_are():
    dark = torch.from_numpy(np.stack([textured()] * 2)).float()
    views = Views(torch.eye(4).repeat(2, 1, 1), torch.eye(3).repeat(2, 1, 1), 18, 13)
    inputs = Problem(views=views, start=SimpleNamespace(), seed=0, srgb8=dark, clean=0.8 * dark)
    assert torch.equal(enhanced(inputs, None, "8bit"), dark)
    assert torch.equal(enhanced_clean(inputs, None, "8bit"), 0.8 * dark)
    record = enhancement_record(None, "8bit")
    assert record == {"enhancer": "none", "pictures": "8bit", "config": {}}
    assert recorded(record)[1] is None


def test_a_study_can_choose_each_of_them():
    config = changed(NovaConfig(), {"enhance": "none"})
    assert config.enhance is None
    settings = {"enhance.guide": "luminance", "enhance.noise_estimator": "camera", "consistency.pairs": "random",
                "consistency.warped": "render", "consistency.confidence": "false", "denoiser.network.blocks": "plain",
                "denoiser.blind_spots.packed": "none"}  # fmt: skip
    config = changed(NovaConfig(), settings)
    assert (config.enhance.guide, config.enhance.noise_estimator) == ("luminance", "camera")
    assert config.consistency.confidence is False
    assert (config.denoiser.network.blocks, config.denoiser.blind_spots.packed) == ("plain", None)
