"""gsplat's call on the virtual GPU, by the readable rasteriser."""

from typing import Any

from torch import Tensor

from novags.splats.raster.rasterize import rasterize
from tests.novags.gpu.virtual import WAITED, Virtual, Wrong, place

TENSORS = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks")


def rasterization(*arguments: Any, backgrounds: Tensor | None = None, **options: Any) -> tuple[Tensor, Tensor, Any]:
    """As `gsplat.rasterization`. What it waits for is its own affair, and not counted."""
    for name, tensor in zip((*TENSORS, "backgrounds"), (*arguments[:7], backgrounds), strict=True):
        if tensor is not None and not isinstance(tensor, Virtual):
            raise Wrong(f"gsplat: {name} must be a CUDA tensor, at {place()}")
    with WAITED.ignored():
        return rasterize(*arguments, backgrounds=backgrounds, backend="torch", **options)
