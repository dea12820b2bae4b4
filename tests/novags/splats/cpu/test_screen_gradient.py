"""Gradients of the centres on the screen, which only densification asks for."""

import pytest
import torch

from novags.splats import rasterize


def as_float32(scene):
    """Leaves of their own, with gradients of their own."""
    return {
        k: v.detach().float().requires_grad_(v.requires_grad) if torch.is_tensor(v) else v for k, v in scene.items()
    }


@pytest.mark.parametrize("channels", [3, 9])  # composited at once, and in three passes
def test_gradients_of_the_centres_equal_the_reference(make_scene, channels):
    scene = make_scene(41, 60, 37, 21)
    g = torch.Generator().manual_seed(0)
    scene["colors"] = torch.rand(60, channels, generator=g, dtype=torch.float64)
    scene["means"].requires_grad_()
    weights = torch.randn(1, 21, 37, channels + 1, generator=g, dtype=torch.float64)
    found = []
    for backend, given in (("torch", scene), ("numba", as_float32(scene))):
        image, alpha, info = rasterize(**given, absgrad=True, packed=False, backend=backend)
        info["means2d"].retain_grad()
        ((image * weights[..., :-1]).sum() + (alpha * weights[..., -1:]).sum()).backward()
        found.append((info["means2d"].grad.double(), info["means2d"].absgrad.double()))
    assert found[0][1].max() > 1
    for expected, got in zip(*found, strict=True):
        torch.testing.assert_close(got, expected, rtol=2e-3, atol=2e-3)
