"""A small reconstruction problem that methods can be run on, and the same as measurements of light."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from novags.methods.noise import Noise, Variance
from novags.methods.problem import Problem
from novags.splats import Gaussians, Views, rasterize
from sensor_model import NoiseCurve, srgb_to_linear

SIZE, VIEWS, POINTS = 24, 5, 150
SLOPE, OFFSET = 3e-4, 2e-7  # of the noise of linear pictures


@dataclass(frozen=True)
class Start:
    points: Tensor
    colors: Tensor
    extent: float


def _cameras() -> Views:
    viewmats = torch.eye(4).repeat(VIEWS, 1, 1)
    viewmats[:, 0, 3] = torch.linspace(-0.4, 0.4, VIEWS)
    viewmats[:, 2, 3] = 3.0
    K = torch.tensor([[30.0, 0, SIZE / 2], [0, 30.0, SIZE / 2], [0, 0, 1]])
    return Views(viewmats, K.repeat(VIEWS, 1, 1), SIZE, SIZE)


@pytest.fixture
def problem() -> Callable[..., Problem]:
    """A textured wall seen dark by five cameras; noise-free and with noise of standard deviation `sigma`."""

    def make(*, sigma: float = 0.01, with_clean: bool = True, seed: int = 0) -> Problem:
        g = torch.Generator().manual_seed(7)
        points = torch.cat(
            [2.4 * torch.rand(POINTS, 2, generator=g) - 1.2, 0.2 * torch.rand(POINTS, 1, generator=g)], 1
        )
        wall = Gaussians.from_points(points, torch.rand(POINTS, 3, generator=g) * 0.8 + 0.1, sh_degree=0)
        views = _cameras()
        lit, _, _ = rasterize(
            wall.means, wall.quats, wall.scales, wall.opacities, wall.sh, views.viewmats, views.Ks, SIZE, SIZE,
            sh_degree=0,
        )  # fmt: skip
        clean = (0.12 * lit).clamp(0, 1)
        dark = (clean + sigma * torch.randn(clean.shape, generator=g)).clamp(0, 1)
        start = Start(points + 0.02, dark.mean((0, 1, 2)).expand(POINTS, 3).contiguous(), views.extent)
        return Problem(views=views, srgb8=dark, clean=clean if with_clean else None, start=start, seed=seed)

    return make


@pytest.fixture
def dark(problem: Callable[..., Problem]) -> Callable[..., tuple[Problem, torch.Tensor]]:
    """A problem with linear pictures of known noise, and the noise-free light [C, H, W, 3]."""

    def make(seed: int = 0) -> tuple[Problem, torch.Tensor]:
        plain = problem(sigma=0.0, seed=seed)
        assert plain.clean is not None
        light = torch.from_numpy(np.asarray(srgb_to_linear(plain.clean.double().numpy()))).float()
        generator = torch.Generator().manual_seed(50 + seed)
        noisy = light + (OFFSET + SLOPE * light).sqrt() * torch.randn(light.shape, generator=generator)
        zero, never = (0.0,) * 3, (math.inf,) * 3
        curve = NoiseCurve(
            black=zero, white=(1.0,) * 3, offset=(OFFSET,) * 3, slope=(SLOPE,) * 3, quadratic=zero, switch=never,
            step=zero,
        )  # fmt: skip
        noise = Noise(Variance(curve), None, "camera")
        return dataclasses.replace(plain, clean=None, linear16=noisy, noise=noise), light

    return make
