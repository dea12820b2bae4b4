"""The accuracy knobs of the splat engine. Run by `bench_splats.py knobs`.

A kernel takes its constants when it is compiled, so every setting compiles them anew, in a process of its own. Seconds
are of one forward and one backward pass. There is no kernel of 64 bits: that setting is the readable reference.
"""

import math
import os
import sys
import tempfile
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from bench_splats_scenes import best, cube_scene
from torch import Tensor

ROWS = 8  # at a time: for its gradient the readable reference keeps every pixel times Gaussian


def strips(scene: dict[str, Tensor], size: int, eps2d: float) -> Iterator[Tensor]:
    """The picture by the readable reference, top to bottom, in strips [ROWS, size, 3]."""
    from novags.splats import rasterize

    shape = [scene[name] for name in ("means", "quats", "scales", "opacities", "sh")]
    for top in range(0, size, ROWS):
        Ks = scene["Ks"].clone()
        Ks[:, 1, 2] -= top
        yield rasterize(
            *shape, scene["viewmats"], Ks, size, ROWS, sh_degree=3, eps2d=eps2d, backend="torch"
        )[0][0]  # fmt: skip


def reference_image(n: int, size: int, *, exact: bool, supersample: int = 1, eps2d: float = 0.3) -> Tensor:
    """The knob scene in float64; `exact` drops both thresholds."""
    from novags.splats import rasterize
    from novags.splats.raster import raster_torch

    if exact:
        raster_torch.ALPHA_MIN, raster_torch.TRANSMITTANCE_MIN = 1e-7, 0.0
    scene = {name: value.double() for name, value in cube_scene(n, size).items()}
    scene["Ks"][:, :2] *= supersample
    shape = [scene[name] for name in ("means", "quats", "scales", "opacities", "sh")]
    camera = (scene["viewmats"], scene["Ks"], size * supersample, size * supersample)
    image = rasterize(*shape, *camera, sh_degree=3, eps2d=eps2d, backend="torch")[0][0]
    return image.reshape(size, supersample, size, supersample, 3).mean((1, 3))


def bake(**constants: Any) -> None:
    """Change constants in all modules of kernels that have them, before any kernel is compiled."""
    for name, module in list(sys.modules.items()):
        if name.startswith("novags.splats.cpu"):
            for constant in constants.keys() & vars(module).keys():
                setattr(module, constant, constants[constant])


def measure_knob(knob: str, setting: float, n: int, size: int, repeat: int, references: str) -> dict[str, Any]:
    """Error and time of one setting."""
    cache = tempfile.TemporaryDirectory(prefix="novags-knob-")
    os.environ["NUMBA_CACHE_DIR"] = cache.name  # before numba is imported
    from novags.splats import rasterize
    from novags.splats.cpu.vectors import vector_math

    if knob == "alpha_min":
        bake(ALPHA_MIN=np.float32(setting), LOG2_ALPHA_MIN=np.float32(np.log2(setting)))
    elif knob == "transmittance_min":
        bake(TRANSMITTANCE_MIN=np.float32(setting))
    elif knob == "tile":
        bake(TILE=int(setting), PER_TILE=np.float32(1 / setting))
    elif knob == "exp2_degree":
        x = -4 + 4 * np.cos(np.pi * (np.arange(400) + 0.5) / 400)
        fit = np.polynomial.Polynomial.fit(x, 2 ** (x / 8), int(setting), w=2 ** (-x / 8)).convert().coef
        for i in range(6):
            setattr(vector_math, f"_A{i}", np.float32(fit[i] if i < len(fit) else 0.0))
    scene, eps2d = cube_scene(n, size), setting if knob == "eps2d" else 0.3
    if wide := (knob, setting) == ("float_bits", 64):
        scene = {name: value.double() for name, value in scene.items()}
    shape = [scene[name].requires_grad_() for name in ("means", "quats", "scales", "opacities", "sh")]
    weights = torch.rand(size, size, 3, dtype=scene["means"].dtype)

    def render() -> Iterator[Tensor]:
        if wide:
            yield from strips(scene, size, eps2d)
        else:
            yield rasterize(*shape, scene["viewmats"], scene["Ks"], size, size, sh_degree=3, eps2d=eps2d)[0][0]

    def once() -> None:
        top = 0
        for image in render():
            torch.autograd.grad(image, shape, weights[top : top + len(image)])
            top += len(image)

    truth = torch.load(references)["supersampled" if knob == "eps2d" else "exact"]
    with torch.no_grad():  # whole: in strips Gaussians beyond their borders are drawn a little differently
        image = reference_image(n, size, exact=False) if wide else next(render())
    error = (image.double() - truth).square().mean((1, 2)).sqrt()  # per row, for a spread
    seconds = best(once, 1 if wide else repeat)
    rmse = float(error.square().mean().sqrt())
    return {"seconds": seconds, "error": rmse, "error_unit": "rmse", "error_sd": float(error.std() / math.sqrt(size))}


KNOBS: dict[str, tuple[tuple[float, ...], float]] = {
    "alpha_min": ((1 / 2550, 1 / 765, 1 / 255, 2 / 255, 4 / 255, 8 / 255), 1 / 255),
    "transmittance_min": ((1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 3e-2), 1e-4),
    "exp2_degree": ((2, 3, 4, 5), 5),
    "eps2d": ((0.0, 0.1, 0.2, 0.3, 0.5), 0.3),
    "float_bits": ((32, 64), 32),
    "tile": ((8, 16), 16),
}
