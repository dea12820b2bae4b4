"""gsplat's call on the virtual GPU, by the readable rasteriser behind it, on the CPU.

What gsplat waits for is its own affair, and not counted.
"""

from typing import Any

import torch
from torch import Tensor

from novags.splats.raster.rasterize import rasterize
from tests.novags.gpu.virtual import Virtual, Wrong, place

TENSORS = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks")


def rasterization(*arguments: Any, backgrounds: Tensor | None = None, **options: Any) -> tuple[Tensor, Tensor, Any]:
    """As `gsplat.rasterization`."""
    for name, tensor in zip((*TENSORS, "backgrounds"), (*arguments[:7], backgrounds), strict=True):
        if tensor is not None and not isinstance(tensor, Virtual):
            raise Wrong(f"gsplat: {name} must be a CUDA tensor, at {place()}")
    info: dict[str, Any] = {}
    renders, alphas = _Rendered.apply(info, (*arguments[7:],), options, *arguments[:7], backgrounds)
    return renders, alphas, info


class _Rendered(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, info: dict[str, Any], size: Any, options: Any, *tensors: Any) -> Any:
        with torch._C.DisableTorchFunction(), torch.enable_grad():
            inner = [None if t is None else t.inner.detach() for t in tensors]
            ctx.leaves = [t.requires_grad_() for t, need in zip(inner, ctx.needs_input_grad[3:], strict=True) if need]
            *gaussians, backgrounds = inner
            *ctx.out, found = rasterize(*gaussians, *size, backgrounds=backgrounds, backend="torch", **options)
            for name in ("means2d", "radii", "depths", "conics", "opacities", "width", "height"):  # as in gsplat's
                value = found[name]
                info[name] = Virtual(value.detach()) if isinstance(value, Tensor) else value
            return tuple(Virtual(out.detach()) for out in ctx.out)

    @staticmethod
    def backward(ctx: Any, *slopes: Any) -> Any:
        with torch._C.DisableTorchFunction():
            inner = [s.inner if isinstance(s, Virtual) else s for s in slopes]
            found = iter(torch.autograd.grad(ctx.out, ctx.leaves, inner, allow_unused=True))
            gradients = [next(found) if need else None for need in ctx.needs_input_grad[3:]]
            return None, None, None, *(None if g is None else Virtual(g) for g in gradients)
