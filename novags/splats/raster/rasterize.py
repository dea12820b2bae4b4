"""The one entry to the rasterisers: checks the input, picks a backend, assembles the channels."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from sensor_model.files.registry import Later

from .gsplat_call import check_choices, check_others
from .info import Projected, Watch, describe
from .sparse import sparse_gradients
from .validation import check_input, check_numbers, ellipsoids

# Imported at use: the readable reference must work where numba does not.
RENDER = {
    "torch": Later("novags.splats.raster.raster_torch:render"),
    "numba": Later("novags.splats.raster.raster_numba:render"),
    "gsplat": Later("novags.splats.raster.raster_gsplat:render"),
}
BACKENDS = ("auto", *RENDER)


def rasterize(
    means: Tensor,
    quats: Tensor | None,
    scales: Tensor | None,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int | None = None,
    backgrounds: Tensor | None = None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: str = "pinhole",
    segmented: bool = False,
    covars: Tensor | None = None,
    *,
    backend: str = "auto",
    check_values: bool = True,
    **others: Any,
) -> tuple[Tensor, Tensor, Mapping[str, Any]]:
    """Splat N Gaussians into C pinhole cameras; names, order, shapes and meaning as in `gsplat.rasterization`.

    Differentiable in all tensors but `Ks`. Gaussians nearer than `near_plane` or beyond `far_plane` are left out.

    Args:
        means: [N, 3] world positions.
        quats: [N, 4] rotations wxyz, any non-zero length. None with `covars`.
        scales: [N, 3] standard deviations along the principal axes, world units, >= 0. None with `covars`.
        opacities: [N], 0..1.
        colors: [N, D] if `sh_degree` is None, else spherical harmonics [N, K, 3], K >= (sh_degree + 1)^2; or one of
            these for each camera, [C, N, D] or [C, N, K, 3].
        viewmats: [C, 4, 4] world to camera, OpenCV axes.
        Ks: [C, 3, 3] intrinsics in pixels, without skew; pixel centres are at +0.5.
        width: Image width.
        height: Image height.
        near_plane: Smallest visible camera z, > 0.
        far_plane: Largest visible camera z.
        radius_clip: Gaussians that reach no farther than this on the image are left out, pixels.
        eps2d: Variance added to every splat on the image, px^2.
        sh_degree: Highest spherical-harmonics degree to use (0..3), or None for plain colours.
        packed: Info has one row for each visible pair of camera and Gaussian [nnz, ...], else [C, N, ...].
        tile_size: None or 16; images do not depend on it.
        backgrounds: [D] or [C, D], dtype as the rest, shown with the weight 1 - alpha; None is black. Not behind depth.
        render_mode: "RGB", "D" (accumulated depth), "ED" (expected depth: accumulated over alpha), "RGB+D", "RGB+ED".
        sparse_grad: The gradients of means, quats and scales are sparse tensors of the visible rows; needs `packed`.
        absgrad: The backward pass leaves the sums over pixels of the absolute gradients of the projected centres in
            info["means2d"].absgrad (AbsGS).
        rasterize_mode: "classic", or "antialiased": opacities fall by sqrt(det / det dilated) where `eps2d` makes a
            splat larger (Mip-Splatting).
        channel_chunk: How many channels gsplat renders at once; images do not depend on it.
        distributed: False.
        camera_model: "pinhole".
        segmented: How gsplat sorts; images do not depend on it.
        covars: [N, 3, 3] covariances instead of `quats` and `scales`; differentiable with "torch" and "gsplat" only.
        backend: "auto" (gsplat for CUDA tensors, else numba), "torch", "numba" (float32, CPU), "gsplat" (CUDA).
        check_values: Whether numbers are looked at, and not shapes alone. A GPU has to be waited for; False if they are
            known to be right.
        others: Further arguments of gsplat, for which nothing but its defaults is supported.

    Returns:
        renders [C, H, W, channels], alphas [C, H, W, 1], and info: "means2d" pixels, whose `retain_grad()` works,
        "radii" [..., 2] int32 pixels (0: not visible), "depths", "conics", "opacities" (with compensation), if packed
        "camera_ids" and "gaussian_ids" (else None), and sizes. Entries other than numbers are made when they are asked
        for. With "numba", one camera and packed=False means2d and depths are views of the kernels' own memory (64 bytes
        per Gaussian): copy what you keep. With "gsplat" it is gsplat's own.

    Raises:
        ValueError: For a wrong shape, dtype or device, values outside their range, non-finite input (of the colours
            only the rendered ones count), an argument of gsplat's that is not supported, or, with "numba", finite input
            so large that float32 overflows.
    """
    check_others({"distributed": distributed, **others})
    check_choices(
        render_mode=render_mode, rasterize_mode=rasterize_mode, camera_model=camera_model, tile_size=tile_size,
        channel_chunk=channel_chunk, sparse_grad=sparse_grad, packed=packed,
    )  # fmt: skip
    if backend not in BACKENDS:
        raise ValueError(f"backend must be one of {BACKENDS}, got {backend!r}")
    if backend == "auto":
        backend = "gsplat" if means.is_cuda else "numba"
    if covars is not None and backend != "gsplat":
        quats, scales = ellipsoids(covars)
    tensors = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors}
    tensors |= {"viewmats": viewmats, "Ks": Ks, "backgrounds": backgrounds, "covars": covars}
    check_numbers(width, height, near_plane, far_plane, eps2d, radius_clip)
    check_input(tensors, sh_degree, render_mode, backend, check_values)
    options: dict[str, Any] = {"sh_degree": sh_degree, "near_plane": near_plane, "far_plane": far_plane, "eps2d": eps2d}
    options["radius_clip"] = radius_clip
    gaussians, camera = (means, quats, scales, opacities), (viewmats, Ks, width, height)
    if backend == "gsplat":
        from .raster_gsplat import render_all

        options |= {"render_mode": render_mode, "rasterize_mode": rasterize_mode, "covars": covars, "packed": packed}
        options |= {"sparse_grad": sparse_grad, "absgrad": absgrad, "channel_chunk": channel_chunk}
        return render_all(*gaussians, colors, *camera, backgrounds=backgrounds, segmented=segmented, **options)
    options |= {"antialiased": rasterize_mode == "antialiased", "watch": Watch(absgrad)}
    options |= {"with_color": render_mode.startswith("RGB"), "with_depth": render_mode.endswith("D")}
    if sparse_grad:
        gaussians, see = sparse_gradients(gaussians)
    renders, alphas, views = _render_each(gaussians, colors, camera, backend, options)
    if sparse_grad:
        see([view.radius for view in views])
    info = describe(views, options["watch"], width=width, height=height, packed=packed)
    return _finish(renders, alphas, render_mode, backgrounds), alphas, info


def _render_each(
    gaussians: tuple[Any, ...], colors: Tensor, camera: tuple[Any, ...], backend: str, options: dict[str, Any]
) -> tuple[Tensor, Tensor, list[Projected]]:
    """Renders [C, H, W, D] and alphas [C, H, W, 1] of the cameras one by one, and their Gaussians."""
    viewmats, Ks, width, height = camera
    for_each = colors.ndim == (3 if options["sh_degree"] is None else 4)
    views = [
        RENDER[backend](
            *gaussians, colors[i] if for_each else colors, viewmats[i], Ks[i], width, height, camera=i, **options
        )
        for i in range(len(viewmats))
    ]
    images, alphas, projected = zip(*views, strict=True)
    return _batch(list(images)), _batch(list(alphas)), list(projected)


def _batch(tensors: list[Tensor]) -> Tensor:
    return tensors[0][None] if len(tensors) == 1 else torch.stack(tensors)  # stacking copies


def _finish(renders: Tensor, alphas: Tensor, render_mode: str, backgrounds: Tensor | None) -> Tensor:
    """Put the background behind the colours and turn accumulated depth into expected depth where asked for."""
    if backgrounds is None and not render_mode.endswith("ED"):
        return renders
    n_color = renders.shape[-1] - render_mode.endswith("D")
    color, depth = renders[..., :n_color], renders[..., n_color:]
    if backgrounds is not None and n_color:
        color = color + (1 - alphas) * backgrounds.reshape(-1, 1, 1, n_color)
    if render_mode.endswith("ED"):
        depth = depth / alphas.clamp_min(1e-10)  # eps: 0/0 where nothing was hit; expected depth is 0 there
    return torch.cat([color, depth], dim=-1)
