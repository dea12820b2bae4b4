"""The one entry to the rasterisers: checks the input, picks a backend, assembles the channels."""

import torch
from torch import Tensor

from .validation import check_camera, check_gaussians, check_numbers, check_shapes, used_colors

RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")
RASTERIZE_MODES = ("classic", "antialiased")
BACKENDS = ("auto", "torch", "numba", "gsplat")


def rasterize(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    *,
    sh_degree: int | None = None,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    eps2d: float = 0.3,
    radius_clip: float = 0.0,
    backgrounds: Tensor | None = None,
    render_mode: str = "RGB",
    rasterize_mode: str = "classic",
    backend: str = "auto",
) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """Splat N Gaussians into C pinhole cameras; names, shapes and meaning as in `gsplat.rasterization`.

    Differentiable in all tensors but `Ks`. Gaussians nearer than `near_plane` or beyond `far_plane` are left out.

    Args:
        means: [N, 3] world positions.
        quats: [N, 4] rotations wxyz, any non-zero length.
        scales: [N, 3] standard deviations along the principal axes, world units, >= 0.
        opacities: [N], 0..1.
        colors: [N, D] if `sh_degree` is None, else spherical harmonics [N, K, 3], K >= (sh_degree + 1)^2.
        viewmats: [C, 4, 4] world to camera, OpenCV axes.
        Ks: [C, 3, 3] intrinsics in pixels, without skew; pixel centres are at +0.5.
        width: Image width.
        height: Image height.
        sh_degree: Highest spherical-harmonics degree to use (0..3), or None for plain colours.
        near_plane: Smallest visible camera z, > 0.
        far_plane: Largest visible camera z.
        eps2d: Variance added to every splat on the image, px^2.
        radius_clip: Gaussians that reach no farther than this on the image are left out, pixels.
        backgrounds: [D] or [C, D], dtype as the rest, shown through what alpha leaves; None is black. Not behind depth.
        render_mode: "RGB", "D" (accumulated depth), "ED" (expected depth: accumulated over alpha), "RGB+D", "RGB+ED".
        rasterize_mode: "classic", or "antialiased": opacities fall by sqrt(det / det dilated) where `eps2d` makes a
            splat larger (Mip-Splatting).
        backend: "auto" (gsplat for CUDA tensors, else numba), "torch", "numba" (float32, CPU), "gsplat" (CUDA).

    Returns:
        renders [C, H, W, channels], alphas [C, H, W, 1], and info with (detached) "means2d" [C, N, 2] pixels,
        "radii" [C, N] int32 pixels (0: not visible) and "depths" [C, N]. With "numba" and one camera these are views
        of the kernels' own memory (64 bytes per Gaussian): copy what you keep.

    Raises:
        ValueError: For a wrong shape, dtype or device, values outside their range, non-finite input (of the colours
            only what is rendered counts), or, with "numba", finite input so large that float32 overflows.
    """
    tensors = {
        "means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors,
        "viewmats": viewmats, "Ks": Ks,
    }  # fmt: skip
    if backgrounds is not None:
        tensors["backgrounds"] = backgrounds
    check_shapes(tensors, sh_degree)
    check_numbers(width, height, near_plane, far_plane, eps2d, radius_clip)
    if render_mode not in RENDER_MODES:
        raise ValueError(f"render_mode must be one of {RENDER_MODES}, got {render_mode!r}")
    if rasterize_mode not in RASTERIZE_MODES:
        raise ValueError(f"rasterize_mode must be one of {RASTERIZE_MODES}, got {rasterize_mode!r}")
    if backend not in BACKENDS:
        raise ValueError(f"backend must be one of {BACKENDS}, got {backend!r}")
    if backend == "auto":
        backend = "gsplat" if means.is_cuda else "numba"
    options = {"sh_degree": sh_degree, "near_plane": near_plane, "far_plane": far_plane, "eps2d": eps2d}
    options |= {"antialiased": rasterize_mode == "antialiased", "radius_clip": radius_clip}
    options |= {"with_color": render_mode.startswith("RGB"), "with_depth": render_mode.endswith("D")}
    # Imported at use: gsplat compiles CUDA code, and the readable reference must work where numba does not.
    check_camera(tensors)
    if backend != "numba":  # the CPU kernels notice bad numbers in passing, and ask for this only then
        check_gaussians({**tensors, "colors": used_colors(colors, sh_degree, render_mode.startswith("RGB"))})
    if backend == "numba":
        from .raster_numba import render
    elif backend == "torch":
        from .raster_torch import render
    else:
        from .raster_gsplat import render
    views = [
        render(means, quats, scales, opacities, colors, viewmat, K, width, height, **options)  # type: ignore[arg-type]
        for viewmat, K in zip(viewmats, Ks, strict=True)
    ]
    renders, alphas = _batch([image for image, _, _ in views]), _batch([alpha for _, alpha, _ in views])
    info = {key: _batch([entry[key] for _, _, entry in views]) for key in ("means2d", "radii", "depths")}
    return _finish(renders, alphas, render_mode, backgrounds), alphas, info


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
