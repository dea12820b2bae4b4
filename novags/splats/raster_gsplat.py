"""The CUDA rasteriser: gsplat behind the same call. The only file that imports gsplat."""

import torch
from torch import Tensor

from .raster_torch import unit_largest

try:
    from gsplat import rasterization
except ImportError as error:
    raise ImportError(
        "CUDA tensors are rendered by gsplat, which is not installed: install it with `pip install 'novags[cuda]'`, "
        "move all tensors to the CPU, or use backend='torch' for scenes of a few hundred Gaussians"
    ) from error


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

    D is the number of colour channels (if `with_color`) plus one for accumulated depth (if `with_depth`). The gradient
    of `viewmat` is gsplat's: along rigid motions it is that of the other backends, entry by entry it is not, because
    gsplat takes the camera's centre from the inverse of the matrix instead of -R^T t.

    Raises:
        ValueError: If the tensors are not float32 on a CUDA device.
    """
    if not means.is_cuda or means.dtype != torch.float32:
        raise ValueError(
            f"backend='gsplat' needs float32 CUDA tensors, got {means.dtype} on {means.device}: convert with "
            ".float().cuda(), or use backend='numba' (float32, CPU) or 'torch' (any float dtype)"
        )
    mode = {(True, False): "RGB", (False, True): "D", (True, True): "RGB+D"}[with_color, with_depth]
    image, alpha, meta = rasterization(
        means, unit_largest(quats), scales, opacities, colors, viewmat[None], K[None], width, height,
        sh_degree=sh_degree, near_plane=near_plane, far_plane=far_plane, eps2d=eps2d, render_mode=mode, packed=False,
        radius_clip=radius_clip, rasterize_mode="antialiased" if antialiased else "classic",
    )  # fmt: skip
    radii = meta["radii"][0]
    if radii.ndim == 2:  # gsplat 1.5 gives one radius per image axis
        radii = radii.amax(-1)
    info = {"means2d": meta["means2d"][0].detach(), "radii": radii, "depths": meta["depths"][0].detach()}
    return image[0], alpha[0], info
