"""The CPU rasteriser: the kernels of `cpu` behind one autograd function. float32; tested against raster_torch."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from .cpu import pipeline
from .first_order import first_order
from .validation import check_gaussians, refuse_overflow, used_colors


def render(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    *,
    sh_degree: int | None,
    near_plane: float,
    far_plane: float,
    eps2d: float,
    antialiased: bool,
    radius_clip: float,
    with_color: bool,
    with_depth: bool,
) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """One camera's image [H, W, D], alpha [H, W, 1] and info; arguments as in `novags.splats.rasterize`.

    D is the number of colour channels (if `with_color`) plus one for accumulated depth (if `with_depth`).

    Raises:
        ValueError: If the tensors are not float32 on the CPU, or hold bad numbers.
    """
    if means.dtype != torch.float32 or means.device.type != "cpu":
        raise ValueError(
            f"backend='numba' needs float32 tensors on the CPU, got {means.dtype} on {means.device}; "
            "convert with .float().cpu(), or use backend='torch' (any float dtype) or 'gsplat' (CUDA)"
        )
    camera = pipeline.Camera(
        viewmat=_array(viewmat), K=_array(K), width=width, height=height, near=near_plane, far=far_plane, eps2d=eps2d,
        antialiased=antialiased, radius_clip=radius_clip,
    )  # fmt: skip
    settings = camera, sh_degree, with_color, with_depth
    image, alpha, means2d, radii, depths = _Render.apply(means, quats, scales, opacities, colors, viewmat, K, settings)
    return image, alpha, {"means2d": means2d, "radii": radii, "depths": depths}


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


def _shape(means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor) -> pipeline.Shape:
    return pipeline.Shape(means=_array(means), quats=_array(quats), scales=_array(scales), opacities=_array(opacities))


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, means, quats, scales, opacities, colors, viewmat, K, settings):  # type: ignore
        camera, sh_degree, with_color, with_depth = settings
        shape = _shape(means, quats, scales, opacities)
        frame, image, alpha = pipeline.forward(shape, _array(colors), camera, sh_degree, with_color, with_depth)
        if frame.splats.suspect:
            used = used_colors(colors, sh_degree, with_color)
            tensors = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": used}
            check_gaussians(tensors)
            refuse_overflow({**tensors, "viewmats": viewmat[None], "Ks": K[None]})
        splats = frame.splats
        info = torch.from_numpy(splats.rows[:, :2]), torch.from_numpy(splats.radii), torch.from_numpy(splats.depths)
        ctx.mark_non_differentiable(*info)
        # All that `backward` reads and others can write to, K and the record's positions too: changes are then noticed.
        ctx.save_for_backward(means, quats, scales, opacities, colors, viewmat, K, info[0])
        ctx.frame = frame
        return torch.from_numpy(image), torch.from_numpy(alpha)[..., None], *info

    @staticmethod
    @first_order
    def backward(ctx: Any, v_image, v_alpha, *_):  # type: ignore[no-untyped-def]
        means, quats, scales, opacities, colors, *_ = ctx.saved_tensors
        shape, v_pixels = _shape(means, quats, scales, opacities), (_array(v_image), _array(v_alpha)[..., 0])
        gradients = pipeline.backward(ctx.frame, shape, _array(colors), *v_pixels, ctx.needs_input_grad[5])
        s = gradients.shape
        arrays = s.means, s.quats, s.scales, s.opacities, gradients.colors, gradients.viewmat
        return *(torch.from_numpy(array) for array in arrays), None, None
