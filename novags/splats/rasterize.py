"""The one entry to the rasterisers: checks the input, picks a backend, assembles the channels."""

import torch
from torch import Tensor

RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")
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
    background: Tensor | None = None,
    render_mode: str = "RGB",
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
        Ks: [C, 3, 3] intrinsics in pixels; pixel centres are at +0.5.
        width: Image width.
        height: Image height.
        sh_degree: Highest spherical-harmonics degree to use (0..3), or None for plain colours.
        near_plane: Smallest visible camera z, > 0.
        far_plane: Largest visible camera z.
        eps2d: Variance added to every splat on the image, px^2.
        background: [D] or [C, D], shown through what alpha leaves; None is black. Not applied to depth.
        render_mode: "RGB", "D" (accumulated depth), "ED" (expected depth: accumulated over alpha), "RGB+D", "RGB+ED".
        backend: "auto" (gsplat for CUDA tensors, else numba), "torch", "numba" (float32, CPU), "gsplat" (CUDA).

    Returns:
        renders [C, H, W, channels], alphas [C, H, W, 1], and info with (detached) "means2d" [C, N, 2] pixels,
        "radii" [C, N] int32 pixels (0: not visible) and "depths" [C, N].

    Raises:
        ValueError: For a wrong shape, dtype or device, values outside their range, or non-finite input.
    """
    tensors = {
        "means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors,
        "viewmats": viewmats, "Ks": Ks,
    }  # fmt: skip
    _check_shapes(tensors, sh_degree, background)
    _check_numbers(width, height, near_plane, far_plane, eps2d)
    if render_mode not in RENDER_MODES:
        raise ValueError(f"render_mode must be one of {RENDER_MODES}, got {render_mode!r}")
    if backend not in BACKENDS:
        raise ValueError(f"backend must be one of {BACKENDS}, got {backend!r}")
    if backend == "auto":
        backend = "gsplat" if means.is_cuda else "numba"
    options = {"sh_degree": sh_degree, "near_plane": near_plane, "far_plane": far_plane, "eps2d": eps2d}
    options |= {"with_color": render_mode.startswith("RGB"), "with_depth": render_mode.endswith("D")}
    _check_values(tensors)
    # Imported at use: gsplat compiles CUDA code, and the readable reference must work where numba does not.
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
    renders = torch.stack([image for image, _, _ in views])
    alphas = torch.stack([alpha for _, alpha, _ in views])
    info = {key: torch.stack([entry[key] for _, _, entry in views]) for key in ("means2d", "radii", "depths")}
    return _finish(renders, alphas, render_mode, background), alphas, info


def _finish(renders: Tensor, alphas: Tensor, render_mode: str, background: Tensor | None) -> Tensor:
    """Put the background behind the colours and turn accumulated depth into expected depth where asked for."""
    if background is None and not render_mode.endswith("ED"):
        return renders
    n_color = renders.shape[-1] - render_mode.endswith("D")
    color, depth = renders[..., :n_color], renders[..., n_color:]
    if background is not None and n_color:
        color = color + (1 - alphas) * background.reshape(-1, 1, 1, n_color)
    if render_mode.endswith("ED"):
        depth = depth / alphas.clamp_min(1e-10)  # eps: 0/0 where nothing was hit; expected depth is 0 there
    return torch.cat([color, depth], dim=-1)


def _check_shapes(tensors: dict[str, Tensor], sh_degree: int | None, background: Tensor | None) -> None:
    n, c = len(tensors["means"]), len(tensors["viewmats"])
    want = {
        "means": (n, 3),
        "quats": (n, 4),
        "scales": (n, 3),
        "opacities": (n,),
        "viewmats": (c, 4, 4),
        "Ks": (c, 3, 3),
    }
    for name, shape in want.items():
        if tensors[name].shape != shape:
            raise ValueError(f"{name} must have shape {list(shape)}, got {list(tensors[name].shape)}")
    if c == 0:
        raise ValueError("viewmats must hold at least one camera, got [0, 4, 4]")
    colors = tensors["colors"]
    if sh_degree is None:
        if colors.ndim != 2 or len(colors) != n or colors.shape[1] == 0:
            raise ValueError(f"colors must be [N={n}, D] when sh_degree is None, got {list(colors.shape)}")
    elif sh_degree not in (0, 1, 2, 3):
        raise ValueError(f"sh_degree must be 0, 1, 2, 3 or None, got {sh_degree}")
    elif colors.ndim != 3 or len(colors) != n or colors.shape[2] != 3 or colors.shape[1] < (sh_degree + 1) ** 2:
        k = (sh_degree + 1) ** 2
        raise ValueError(f"colors must be [N={n}, K >= {k}, 3] for sh_degree={sh_degree}, got {list(colors.shape)}")
    channels = colors.shape[1] if sh_degree is None else 3
    if background is not None and background.shape not in ((channels,), (c, channels)):
        raise ValueError(f"background must be [{channels}] or [{c}, {channels}], got {list(background.shape)}")
    for name, value in tensors.items():
        if value.dtype != colors.dtype or value.device != colors.device or not value.is_floating_point():
            raise ValueError(
                f"all tensors must share one float dtype and device: {name} is {value.dtype} on {value.device}, "
                f"colors is {colors.dtype} on {colors.device}"
            )


def _check_numbers(width: int, height: int, near_plane: float, far_plane: float, eps2d: float) -> None:
    if width < 1 or height < 1:
        raise ValueError(f"width and height must be at least 1 pixel, got {width} x {height}")
    if not 0 < near_plane < far_plane:
        raise ValueError(f"planes must satisfy 0 < near_plane < far_plane, got {near_plane} and {far_plane}")
    if not eps2d >= 0:
        raise ValueError(f"eps2d must be >= 0 px^2, got {eps2d}")


def _check_values(tensors: dict[str, Tensor]) -> None:
    for name, value in tensors.items():
        bad = int((~torch.isfinite(value)).sum())
        if bad:
            raise ValueError(f"{name} must be finite, got {bad} non-finite of {value.numel()} values")
    rules = {
        "quats": ("must not be zero", (tensors["quats"] == 0).all(-1)),
        "scales": ("must be >= 0", (tensors["scales"] < 0).any(-1)),
        "opacities": ("must lie in 0..1", (tensors["opacities"] < 0) | (tensors["opacities"] > 1)),
    }
    for name, (rule, wrong) in rules.items():
        if wrong.any():
            first = int(torch.nonzero(wrong)[0, 0])
            raise ValueError(
                f"{name} {rule}, got {tensors[name][first].tolist()} at Gaussian {first} ({int(wrong.sum())} of {len(wrong)})"
            )
