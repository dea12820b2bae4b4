"""The CUDA rasteriser: gsplat behind the same call. The only file that imports gsplat."""

from typing import Any

from torch import Tensor

from .raster_torch import unit_largest

try:
    from gsplat import rasterization
except ImportError as error:
    raise ImportError(
        "CUDA tensors are rendered by gsplat, which is not installed: install it with `pip install 'novags[cuda]'`, "
        "move all tensors to the CPU, or use backend='torch' for scenes of a few hundred Gaussians"
    ) from error


def render_all(
    means: Tensor, quats: Tensor | None, scales: Tensor | None, opacities: Tensor, colors: Tensor, viewmats: Tensor,
    Ks: Tensor, width: int, height: int, *, backgrounds: Tensor | None, **options: Any,
) -> tuple[Tensor, Tensor, dict[str, Any]]:  # fmt: skip
    """All cameras' images, alphas and gsplat's own info; arguments as in `novags.splats.rasterize`.

    The gradient of `viewmats` is gsplat's: along rigid motions it equals the other backends' gradient, entry by entry
    it does not, because gsplat takes the camera's centre from the inverse of the matrix instead of -R^T t.

    Raises:
        ValueError: If the tensors are not float32 on a CUDA device.
    """
    if not means.is_cuda or str(means.dtype) != "torch.float32":
        raise ValueError(
            f"backend='gsplat' needs float32 CUDA tensors, got {means.dtype} on {means.device}: convert with "
            ".float().cuda(), or use backend='numba' (float32, CPU) or 'torch' (any float dtype)"
        )
    if backgrounds is not None:
        backgrounds = backgrounds.expand(len(viewmats), -1)
    return rasterization(
        means, None if quats is None else unit_largest(quats), scales, opacities, colors, viewmats, Ks, width, height,
        backgrounds=backgrounds, **options,
    )  # fmt: skip
