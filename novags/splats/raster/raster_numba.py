"""The CPU rasteriser: the kernels of `cpu` behind one autograd function. float32; tested against raster_torch."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..cpu import pipeline
from ..cpu.raster import record
from ..first_order import first_order
from .info import Projected, Watch
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
    watch: Watch,
    camera: int,
) -> tuple[Tensor, Tensor, Projected]:
    """One camera's image [H, W, D], alpha [H, W, 1] and its Gaussians; arguments as in `novags.splats.rasterize`.

    The gradient of its means2d goes to `watch`, under its number `camera`. D is the number of colour channels (if
    `with_color`) plus one for accumulated depth (if `with_depth`).

    Raises:
        ValueError: If the tensors are not float32 on the CPU, or hold bad numbers.
    """
    if means.dtype != torch.float32 or means.device.type != "cpu":
        raise ValueError(
            f"backend='numba' needs float32 tensors on the CPU, got {means.dtype} on {means.device}; "
            "convert with .float().cpu(), or use backend='torch' (any float dtype) or 'gsplat' (CUDA)"
        )
    pinhole = pipeline.RasterCamera(
        viewmat=_array(viewmat), K=_array(K), width=width, height=height, near=near_plane, far=far_plane, eps2d=eps2d,
        antialiased=antialiased, radius_clip=radius_clip,
    )  # fmt: skip
    settings = pinhole, sh_degree, with_color, with_depth, watch, camera
    image, alpha, means2d, radius, depths, rows = _Render.apply(
        means, quats, scales, opacities, colors, viewmat, K, settings
    )
    return image, alpha, projected(means2d, radius, depths, rows)


def projected(means2d: Tensor, radius: Tensor, depths: Tensor, rows: Tensor) -> Projected:
    """The Gaussians in a camera from the records of the kernels [N, ROW]."""
    unit = float(record.HALF_LOG2E)

    def footprint() -> tuple[Tensor, Tensor, Tensor]:
        radii = torch.where(radius[:, None] > 0, rows[:, (record.REACH_X, record.REACH_Y)].ceil().clamp(1, 2**30), 0.0)
        a, k, q = rows[:, record.A] / unit, rows[:, record.K], rows[:, record.Q] / unit
        conics = torch.stack([a, a * k, a * k * k + q], -1)
        return radii.to(torch.int32), conics, torch.where(radius > 0, torch.exp2(rows[:, record.TOP]), 0.0)

    return Projected(means2d=means2d, radius=radius, depths=depths, footprint=footprint)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


def _shape(means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor) -> pipeline.Shape:
    return pipeline.Shape(means=_array(means), quats=_array(quats), scales=_array(scales), opacities=_array(opacities))


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, means, quats, scales, opacities, colors, viewmat, K, settings):  # type: ignore
        ctx.set_materialize_grads(False)
        camera, sh_degree, with_color, with_depth, ctx.watch, ctx.number = settings
        shape = _shape(means, quats, scales, opacities)
        frame, image, alpha = pipeline.forward(shape, _array(colors), camera, sh_degree, with_color, with_depth)
        if frame.splats.suspect:
            used = used_colors(colors, sh_degree, with_color)
            tensors = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": used}
            check_gaussians(tensors)
            refuse_overflow({**tensors, "viewmats": viewmat[None], "Ks": K[None]})
        splats = frame.splats
        rows = torch.from_numpy(splats.rows)
        info = rows[:, :2], torch.from_numpy(splats.radii), torch.from_numpy(splats.depths), rows.view(rows.shape)
        ctx.mark_non_differentiable(*info[1:])
        # All that `backward` reads and others can write to, K and the record's positions too: changes are then noticed.
        ctx.save_for_backward(means, quats, scales, opacities, colors, viewmat, K, info[0])
        ctx.frame, ctx.channels = frame, image.shape[-1]
        return torch.from_numpy(image), torch.from_numpy(alpha)[..., None], *info

    @staticmethod
    @first_order
    def backward(ctx: Any, v_image, v_alpha, v_means2d, *_):  # type: ignore[no-untyped-def]
        if v_means2d is not None:
            raise RuntimeError(
                "info['means2d'] of the CPU kernels has a gradient, but none can be passed on through it: use "
                "rasterize(..., backend='torch') where a loss depends on it"
            )
        means, quats, scales, opacities, colors, *_ = ctx.saved_tensors
        frame = ctx.frame
        size, channels = (frame.camera.height, frame.camera.width), ctx.channels
        v_image = np.zeros((*size, channels), np.float32) if v_image is None else _array(v_image)
        v_alpha = np.zeros(size, np.float32) if v_alpha is None else _array(v_alpha)[..., 0]
        shape, v_pixels = _shape(means, quats, scales, opacities), (v_image, v_alpha)
        if ctx.watch.wanted:
            from ..cpu.raster.screen_gradient import screen_gradient  # compiled only where it is asked for

            ctx.watch.add(ctx.number, *(torch.from_numpy(v) for v in screen_gradient(frame, *v_pixels)))
        gradients = pipeline.backward(frame, shape, _array(colors), *v_pixels, ctx.needs_input_grad[5])
        s = gradients.shape
        arrays = s.means, s.quats, s.scales, s.opacities, gradients.colors, gradients.viewmat
        return *(torch.from_numpy(array) for array in arrays), None, None
