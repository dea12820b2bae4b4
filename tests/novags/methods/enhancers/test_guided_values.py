"""Enhancement of a textured image against equations 3 to 5 written out, with loops over pixels."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.optimize import brentq

from novags.methods.enhancers import guided
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import EnhanceParams, enhance, guided_filter
from novags.methods.enhancers.pictures import solve_gamma


def textured(height: int = 13, width: int = 18, level: float = 0.15) -> np.ndarray:
    """Dark and rough, with a spot that enhancement clips and a black pixel."""
    rng = np.random.default_rng(0)
    image = level * rng.uniform(0.2, 1, (height, width, 3))
    image[3, 4] = 0.9
    image[8, 11] = 0.0
    return image


def enhance_by_hand(
    smooth: Callable[..., np.ndarray], dark: np.ndarray, radius: int, epsilon: float, target: float, eta: float
) -> tuple[np.ndarray, float]:
    L = np.stack([smooth(dark[..., c], radius, epsilon) for c in range(3)], -1)
    bounded = np.maximum(L, eta)
    gamma = brentq(lambda g: (bounded**g).mean() - target, 0.02, 5.0, xtol=1e-13)
    R = bounded**gamma / (L + eta)
    return np.minimum(dark * R, 1), gamma


@pytest.mark.parametrize(("target", "eta"), [(0.5, 1e-4), (0.6, 0.03)])
def test_enhancement_is_the_published_equation(smooth_by_hand, monkeypatch, target, eta):
    monkeypatch.setattr(guided, "patch_pca_sigma", lambda image: torch.tensor(0.1, dtype=torch.float64))
    dark = textured()
    config = EnhanceConfig(window=7, target=target, eta=eta, noise_factor=2.5, bisection_steps=60)
    found, params = enhance(torch.from_numpy(dark), config)
    expected, gamma = enhance_by_hand(smooth_by_hand, dark, 3, 2.5 * 0.1**2, target, eta)
    assert float(params.gamma) == pytest.approx(gamma, rel=1e-9)
    assert float(params.epsilon) == pytest.approx(2.5 * 0.1**2)
    assert params.radius == 3
    assert (expected == 1).any()
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-12)


def test_the_ratio_multiplies_the_image_not_its_smooth_version():
    """Rationale: L R would be a picture without texture; the texture of the input must survive."""
    dark = textured()
    _, params = enhance(torch.from_numpy(dark), EnhanceConfig(window=7))
    coarse = EnhanceParams(gamma=params.gamma, epsilon=torch.tensor(1e3, dtype=torch.float64), radius=3)
    found = enhance(torch.from_numpy(dark), EnhanceConfig(window=7), coarse)[0].numpy()
    rough = dark[9:, 5:, 1]  # where nothing clips, and the brightness map is all but constant
    assert np.corrcoef(found[9:, 5:, 1].ravel(), rough.ravel())[0, 1] > 0.98


@pytest.mark.parametrize(("kind", "estimator"), [("patch-pca", "patch_pca_sigma"), ("immerkaer", "immerkaer_sigma")])
def test_epsilon_is_the_estimated_variance_of_each_image(monkeypatch, kind, estimator):
    monkeypatch.setattr(guided, estimator, lambda image: image.double().mean() / 7)
    dark = torch.from_numpy(np.stack([textured(level=0.1), textured(level=0.3)]))
    _, params = enhance(dark, EnhanceConfig(window=5, noise_estimator=kind))
    expected = [(float(image.mean()) / 7) ** 2 for image in dark]
    np.testing.assert_allclose(params.epsilon, expected, rtol=1e-9)


def test_epsilon_by_the_camera_is_of_each_image():
    dark = torch.from_numpy(np.stack([textured(level=0.1), textured(level=0.3)]))
    config = EnhanceConfig(window=5, noise_estimator="camera")
    _, both = enhance(dark, config, noise=lambda light: 1e-4 + 0.01 * light)
    alone = [enhance(image, config, noise=lambda light: 1e-4 + 0.01 * light)[1] for image in dark]
    assert both.epsilon.tolist() == [float(each.epsilon) for each in alone]
    assert both.epsilon[0] != both.epsilon[1]


def test_typical_parameters_are_the_means_of_all():
    given = [
        EnhanceParams(gamma=torch.tensor(g), epsilon=torch.tensor(e), radius=4) for g, e in ((0.5, 2.0), (0.3, 1.0))
    ]
    found = guided.typical(given)
    assert (float(found.gamma), float(found.epsilon), found.radius) == (pytest.approx(0.4), 1.5, 4)


@pytest.mark.parametrize(
    ("size", "window", "radius"), [((20, 30), 9, 4), ((6, 30), 9, 2), ((30, 7), 9, 3), ((4, 4), 33, 1), ((9, 9), 1, 0)]
)
def test_the_window_shrinks_to_the_shorter_side(size, window, radius):
    _, params = enhance(torch.from_numpy(textured(30, 30)[: size[0], : size[1]]), EnhanceConfig(window=window))
    assert params.radius == radius


def test_every_image_of_a_batch_has_its_own_epsilon_and_every_channel_its_own_guide(smooth_by_hand):
    rng = np.random.default_rng(1)
    image = rng.uniform(0, 1, (2, 3, 8, 9))
    epsilon = [1e-3, 0.3]
    found = guided_filter(torch.from_numpy(image), 2, torch.tensor(epsilon))
    for b in range(2):
        for c in range(3):
            expected = smooth_by_hand(image[b, c], 2, float(torch.tensor(epsilon[b])))
            np.testing.assert_allclose(found[b, c], expected, rtol=1e-9)


def test_a_constant_window_without_epsilon_is_left_as_it_is():
    image = torch.full((1, 1, 6, 6), 0.25)
    assert torch.equal(guided_filter(image, 2, torch.tensor([0.0])), image)


def test_gamma_is_solved_image_by_image():
    rng = np.random.default_rng(0)
    brightness = np.stack([rng.uniform(0.01, 0.2, (5, 6)), rng.uniform(0.3, 1, (5, 6))])
    config = EnhanceConfig(target=0.45, bisection_steps=60)
    expected = [brentq(lambda g, b=b: (b**g).mean() - 0.45, 0.02, 5, xtol=1e-13) for b in brightness]
    np.testing.assert_allclose(solve_gamma(torch.from_numpy(brightness), config), expected, rtol=1e-9)


def test_gamma_stops_at_the_ends_of_its_range():
    config = EnhanceConfig(gamma_min=0.5, gamma_max=2.0, target=0.5)
    brightness = torch.tensor([[0.9, 0.9], [0.01, 0.01]], dtype=torch.float64)
    assert solve_gamma(brightness, config).tolist() == pytest.approx([2.0, 0.5])


def test_the_number_of_bisections_halves_the_range_that_often():
    config = EnhanceConfig(gamma_min=1.0, gamma_max=3.0, bisection_steps=1)
    assert solve_gamma(torch.tensor([[0.99]]), config).tolist() == [2.5]


def test_the_published_choices_are_the_defaults():
    config = EnhanceConfig()
    assert (config.window, config.target, config.eta) == (33, 0.5, 1e-4)
    assert (config.noise_estimator, config.noise_factor) == ("patch-pca", 1.0)
    assert (config.gamma_min, config.gamma_max, config.bisection_steps) == (0.02, 5.0, 40)


def test_given_params_are_used_unchanged(smooth_by_hand):
    dark = torch.from_numpy(np.stack([textured(level=0.1), textured(level=0.3)]))
    params = EnhanceParams(
        gamma=torch.tensor([0.4, 0.7]).double(), epsilon=torch.tensor([1e-4, 1e-2]).double(), radius=2
    )
    found, used = enhance(dark, EnhanceConfig(window=9), params)
    assert used.radius == 2
    assert torch.equal(used.gamma, params.gamma)
    assert torch.equal(used.epsilon, params.epsilon)
    for i in range(2):
        plane = dark[i].numpy()
        L = np.stack([smooth_by_hand(plane[..., c], 2, float(params.epsilon[i])) for c in range(3)], -1)
        expected = np.minimum(plane * np.maximum(L, 1e-4) ** float(params.gamma[i]) / (L + 1e-4), 1)
        np.testing.assert_allclose(found[i], expected, rtol=1e-7, atol=1e-12)


def test_gamma_and_epsilon_are_constants_to_the_gradient():
    _, params = enhance(torch.from_numpy(textured()).requires_grad_())
    assert not params.epsilon.requires_grad
    assert not params.gamma.requires_grad
