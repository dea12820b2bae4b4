"""Scenes for the rasteriser tests: dictionaries of the arguments of `rasterize`, float64 but rounded to float32."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

Scene = dict[str, Any]


def look(generator: torch.Generator, distance: float) -> Tensor:
    """A random rotation and a camera `distance` away from the origin."""
    rotation, _ = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    view = torch.eye(4, dtype=torch.float64)
    view[:3, :3] = rotation * torch.linalg.det(rotation)
    view[2, 3] = distance
    return view


def build(seed: int, n: int, width: int, height: int, *, sh_degree: int | None = None, cameras: int = 1) -> Scene:
    """n Gaussians of all sizes in a cube of side 2, seen from random directions."""
    g = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=g, dtype=torch.float64)

    colors = uniform(n, 3) if sh_degree is None else torch.randn(n, 16, 3, generator=g, dtype=torch.float64) * 0.3
    focal = 0.9 * max(width, height)
    K = torch.tensor([[focal, 0, 0.52 * width], [0, 1.1 * focal, 0.47 * height], [0, 0, 1]], dtype=torch.float64)
    scene: Scene = {
        "means": 2 * uniform(n, 3) - 1,
        "quats": torch.randn(n, 4, generator=g, dtype=torch.float64),
        "scales": torch.exp(torch.log(torch.tensor(0.5)) - 4 * uniform(n, 3)),
        "opacities": uniform(n),
        "colors": colors,
        "viewmats": torch.stack([look(g, 3.0) for _ in range(cameras)]),
        "Ks": K.repeat(cameras, 1, 1),
    }
    scene = {name: value.float().double() for name, value in scene.items()}
    return {**scene, "width": width, "height": height, "sh_degree": sh_degree}


@pytest.fixture
def make_scene() -> Callable[..., Scene]:
    return build
