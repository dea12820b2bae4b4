"""The scene that measurements of the splat engine share, its truth, and how a kernel's constant is changed."""

import math
import sys
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from novags.splats.raster import raster_torch
from novags.splats.raster.rasterize import rasterize

ROWS = 8  # at a time: for its gradient the readable reference keeps every pixel times Gaussian
NAMES = ("means", "quats", "scales", "opacities", "sh")


def cube_scene(n: int, size: int, seed: int = 0) -> dict[str, Tensor]:
    """Small Gaussians in [-1, 1]^3, about half as wide as their distances, seen from outside."""
    g = torch.Generator().manual_seed(seed)
    view = torch.eye(4)
    view[2, 3] = 3.0
    return {
        "means": 2 * torch.rand(n, 3, generator=g) - 1,
        "quats": torch.randn(n, 4, generator=g),
        "scales": torch.exp(0.4 * torch.randn(n, 3, generator=g)) * 0.4 * n ** (-1 / 3),
        "opacities": 0.05 + 0.9 * torch.rand(n, generator=g),
        "sh": 0.3 * torch.randn(n, 16, 3, generator=g),
        "viewmats": view[None],
        "Ks": torch.tensor([[[1.0 * size, 0, size / 2], [0, 1.0 * size, size / 2], [0, 0, 1]]]),
    }


def draw(scene: Mapping[str, Tensor], Ks: Tensor, width: int, height: int, **options: Any) -> Tensor:
    """One picture [height, width, 3] of a scene, colours of degree 3."""
    image, _, _ = rasterize(
        scene["means"], scene["quats"], scene["scales"], scene["opacities"], scene["sh"], scene["viewmats"], Ks, width,
        height, sh_degree=3, **options,
    )  # fmt: skip
    return image[0]


def strips(scene: Mapping[str, Tensor], size: int, eps2d: float) -> Iterator[Tensor]:
    """The picture by the readable reference, top to bottom, in strips [ROWS, size, 3]."""
    for top in range(0, size, ROWS):
        Ks = scene["Ks"].clone()
        Ks[:, 1, 2] -= top
        yield draw(scene, Ks, size, min(ROWS, size - top), eps2d=eps2d, backend="torch")


def reference(
    n: int, size: int, seed: int, *, exact: bool, supersample: int = 1, eps2d: float = 0.3, bits: int = 64
) -> Tensor:
    """The picture [size, size, 3] by the readable reference; `exact` drops both thresholds, for the whole process."""
    if exact:
        raster_torch.ALPHA_MIN, raster_torch.TRANSMITTANCE_MIN = 1e-7, 0.0
    kind = torch.float64 if bits == 64 else torch.float32
    scene = {name: value.to(kind) for name, value in cube_scene(n, size, seed).items()}
    scene["Ks"][:, :2] *= supersample
    side = size * supersample
    with torch.no_grad():
        image = draw(scene, scene["Ks"], side, side, eps2d=eps2d, backend="torch")
    return image.reshape(size, supersample, size, supersample, 3).mean((1, 3))


def bake(**constants: Any) -> None:
    """Change constants in all modules of kernels that have them, before any kernel is compiled."""
    for name, module in list(sys.modules.items()):
        if name.startswith("novags.splats.cpu"):
            for constant in constants.keys() & vars(module).keys():
                setattr(module, constant, constants[constant])


def turn(knob: str, setting: Any) -> None:
    """Give a constant of the kernels another value."""
    from novags.splats.cpu.raster.record import BLOCK, CHANNELS
    from novags.splats.cpu.vectors import vector_math
    from novags.splats.cpu.vectors.simd import LANES

    if knob == "alpha_min":
        bake(ALPHA_MIN=np.float32(setting), LOG2_ALPHA_MIN=np.float32(math.log2(setting)))
    elif knob == "transmittance_min":
        bake(TRANSMITTANCE_MIN=np.float32(setting))
    elif knob == "tile":
        side = int(setting)
        blocks = {"SIDE": side // BLOCK, "PIXELS": side**2, "BLOCKS": side**2 // LANES, "COLOR": CHANNELS * side**2}
        bake(TILE=side, PER_TILE=np.float32(1 / side), **blocks)
    elif knob == "exp2_degree":
        x = -4 + 4 * np.cos(np.pi * (np.arange(400) + 0.5) / 400)
        fit = np.polynomial.Polynomial.fit(x, 2 ** (x / 8), int(setting), w=2 ** (-x / 8)).convert().coef
        for i in range(6):
            setattr(vector_math, f"_A{i}", np.float32(fit[i] if i < len(fit) else 0.0))
