"""What the paper leaves open of the geometric loss: what is warped, and a loss without C."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from novags.methods.nova.config import ConsistencyConfig, NovaConfig
from novags.methods.nova.consistency import ConsistencyLoss, Pinhole, reproject
from novags.splats.views import Views

HEIGHT, WIDTH = 12, 16


def looking(centres: np.ndarray, yaws: np.ndarray) -> Views:
    """Cameras at these places, turned about the vertical axis by these degrees."""
    viewmats = torch.eye(4).repeat(len(centres), 1, 1)
    for i, (centre, yaw) in enumerate(zip(centres, np.radians(yaws), strict=True)):
        R = np.array([[math.cos(yaw), 0, -math.sin(yaw)], [0, 1, 0], [math.sin(yaw), 0, math.cos(yaw)]])
        viewmats[i, :3, :3], viewmats[i, :3, 3] = torch.from_numpy(R).float(), torch.from_numpy(-R @ centre).float()
    K = torch.tensor([[20.0, 0, 8], [0, 20.0, 6], [0, 0, 1]])
    return Views(viewmats, K.repeat(len(centres), 1, 1), WIDTH, HEIGHT)


def stage(config: ConsistencyConfig) -> tuple[ConsistencyLoss, SimpleNamespace, torch.Tensor, torch.Tensor]:
    """A loss between two cameras before a wall, its step, the pictures and the renderings of both."""
    views = looking(np.array([[-0.3, 0.0, 0.0], [0.3, 0.1, 0.05]]), np.array([2.0, -3.0]))
    generator = torch.Generator().manual_seed(0)
    pictures, renders = torch.rand(2, 2, HEIGHT, WIDTH, 3, generator=generator)
    depth, alpha = torch.full((HEIGHT, WIDTH), 3.0), torch.ones(HEIGHT, WIDTH)
    loss = ConsistencyLoss(views, pictures.__getitem__, config, iterations=10, seed=0)
    loss.candidates = [[1], [0]]
    step = SimpleNamespace(
        view=0, iteration=5, views=views, render=renders[0].clone().requires_grad_(), depth=depth.clone(), alpha=alpha,
        rasterize_view=lambda j: (renders[j], depth, alpha, {}),
    )  # fmt: skip
    return loss, step, pictures, renders


def photometric(views: Views, images: torch.Tensor) -> tuple[float, float]:
    """Mean |I_t - I_s| over the valid pixels, by a loop, and how many there are."""
    depth = torch.full((HEIGHT, WIDTH), 3.0)
    warped, mask = reproject(images[1], depth, depth, Pinhole.of(views, 0), Pinhole.of(views, 1))
    found = [float((images[0] - warped)[y, x].abs().mean()) for y, x in np.ndindex(HEIGHT, WIDTH) if mask[y, x]]
    return float(np.mean(found)), len(found)


@pytest.mark.parametrize("warped", ["clean", "enhanced", "render"])
def test_what_is_warped_is_compared_with_the_same_of_the_target(warped):
    config = ConsistencyConfig(start=0.0, max_distance=5.0, warped=warped, confidence=False, weight=0.7)
    loss, step, pictures, renders = stage(config)
    expected, count = photometric(step.views, renders if warped == "render" else pictures)
    assert count > 50
    found = loss(step).detach()
    assert float(found) == pytest.approx(0.7 * expected, rel=1e-5)


def test_a_rendered_target_receives_the_loss_and_a_rendered_source_does_not():
    loss, step, _, renders = stage(ConsistencyConfig(start=0.0, max_distance=5.0, warped="render", confidence=False))
    renders.requires_grad_()
    loss(step).backward()
    assert float(step.render.grad.abs().sum()) > 0
    assert renders.grad is None


def test_without_confidence_its_weight_and_its_network_play_no_part():
    values = {}
    for weight in (0.0, 10.0):
        loss, step, pictures, _ = stage(
            ConsistencyConfig(start=0.0, max_distance=5.0, confidence=False, confidence_weight=weight)
        )
        step.depth.requires_grad_()
        found = loss(step)
        found.backward()
        assert all(p.grad is None for p in loss.network.parameters())
        before = [p.detach().clone() for p in loss.network.parameters()]
        loss.update()
        assert all(torch.equal(p, b) for p, b in zip(loss.network.parameters(), before, strict=True))
        values[weight] = float(found.detach())
    assert values[0.0] == values[10.0] == pytest.approx(photometric(step.views, pictures)[0], rel=1e-5)


def test_the_papers_choices_are_the_defaults():
    config = ConsistencyConfig()
    assert (config.pairs, config.warped, config.confidence) == ("nearest", "clean", True)
    assert NovaConfig().denoiser.blind_spots.packed is False
