"""The CPU rasteriser: numba kernels behind one autograd function. float32; the truth it is tested against is raster_torch."""

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from . import kernels_bin as kb
from . import kernels_composite as kc
from . import kernels_project as kp
from . import kernels_sh as ks


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
    with_color: bool,
    with_depth: bool,
) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """One camera's image [H, W, D], alpha [H, W, 1] and info; arguments as in `novags.splats.rasterize`.

    D is the number of colour channels (if `with_color`) plus one for accumulated depth (if `with_depth`).

    Raises:
        ValueError: If the tensors are not float32 on the CPU.
    """
    if means.dtype != torch.float32 or means.is_cuda:
        raise ValueError(
            f"backend='numba' needs float32 tensors on the CPU, got {means.dtype} on {means.device}; "
            "convert with .float().cpu(), or use backend='torch' (any float dtype) or 'gsplat' (CUDA)"
        )
    settings = (width, height, sh_degree, near_plane, far_plane, eps2d, with_color, with_depth)
    image, alpha, means2d, radii, depths = _Render.apply(means, quats, scales, opacities, colors, viewmat, K, settings)
    return image, alpha, {"means2d": means2d, "radii": radii, "depths": depths}


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, means, quats, scales, opacities, colors, viewmat, K, settings):  # type: ignore[no-untyped-def]
        width, height, sh_degree, near, far, eps2d, with_color, with_depth = settings
        inputs = [_array(t) for t in (means, quats, scales, opacities, colors, viewmat, K)]
        m, q, s, o, c, view, k = inputs
        n = len(m)
        splats = np.empty((n, kp.SPLAT_SIZE), np.float32)
        depths, radii = np.empty(n, np.float32), np.empty(n, np.int32)
        f32 = np.float32
        kp.project_forward(
            m, q, s, o, view, k, f32(width), f32(height), f32(near), f32(far), f32(eps2d), splats, depths, radii
        )
        if not with_color:
            features = np.empty((n, 0), np.float32)
        elif sh_degree is None:
            features = c
        else:
            center = -view[:3, :3].T @ view[:3, 3]
            features = np.empty((n, 3), np.float32)
            ks.sh_forward(sh_degree, m, c, center, radii, features)
        order = np.empty(n, np.int32)
        order = order[: kb.depth_order(depths, radii, order)]
        lists = _tile_lists(splats, order, width, height)
        packed = np.empty((len(order), kc.GEOMETRY + features.shape[1] + with_depth), np.float32)
        kc.pack(splats, order, features, depths, with_depth, packed)
        image = np.empty((height, width, packed.shape[1] - kc.GEOMETRY), np.float32)
        transmittance, last = np.empty((height, width), np.float32), np.empty((height, width), np.int32)
        ranks, _, _, tile_starts = lists
        tile_ends = np.empty(len(tile_starts) - 1, np.int64)
        kc.composite_forward(packed, ranks, tile_starts, numba.get_num_threads(), image, transmittance, last, tile_ends)

        ctx.state = (inputs, settings, splats, radii, features, order, lists, packed, transmittance, last, tile_ends)
        means2d = torch.where(torch.from_numpy(radii)[:, None] > 0, torch.from_numpy(splats[:, :2]), 0.0)
        outputs = torch.from_numpy(image), 1 - torch.from_numpy(transmittance)[..., None]
        info = means2d, torch.from_numpy(radii), torch.from_numpy(depths)
        ctx.mark_non_differentiable(*info)
        return *outputs, *info

    @staticmethod
    def backward(ctx: Any, v_image, v_alpha, *_):  # type: ignore[no-untyped-def]
        inputs, settings, splats, radii, features, order, lists, packed, transmittance, last, tile_ends = ctx.state
        m, q, s, o, c, view, k = inputs
        width, height, sh_degree, _, _, eps2d, with_color, _ = settings
        ranks, places, offsets, tile_starts = lists
        v_rows = np.empty((len(ranks), packed.shape[1]), np.float32)
        kc.composite_backward(
            packed, ranks, tile_starts, tile_ends, numba.get_num_threads(), transmittance, last,
            _array(v_image), -_array(v_alpha)[..., 0], v_rows,
        )  # fmt: skip
        n = len(m)
        v_splats, v_features, v_depths = (
            np.zeros(shape, np.float32) for shape in ((n, kc.GEOMETRY), features.shape, n)
        )
        kc.gather_gradients(v_rows, offsets, places, order, o, features.shape[1], v_splats, v_features, v_depths)

        v_means, v_quats, v_scales, v_opacities = (np.empty_like(a) for a in (m, q, s, o))
        n_blocks = -(-n // kp.BLOCK)
        v_view_blocks = np.empty((n_blocks if ctx.needs_input_grad[5] else 0, 3, 4), np.float32)
        kp.project_backward(
            m, q, s, view, k, np.float32(width), np.float32(height), np.float32(eps2d), splats, radii, v_splats, v_depths,
            v_means, v_quats, v_scales, v_opacities, v_view_blocks,
        )  # fmt: skip
        v_view = np.zeros((4, 4), np.float32)
        v_view[:3] = v_view_blocks.sum(0, dtype=np.float64)
        if not with_color:
            v_colors = np.zeros_like(c)
        elif sh_degree is None:
            v_colors = v_features
        else:
            v_colors = np.empty_like(c)
            v_center_blocks = np.empty((n_blocks, 3), np.float32)
            center = -view[:3, :3].T @ view[:3, 3]
            ks.sh_backward(sh_degree, m, c, center, radii, features, v_features, v_colors, v_means, v_center_blocks)
            v_center = v_center_blocks.sum(0)
            v_view[:3, 3] -= view[:3, :3] @ v_center
            v_view[:3, :3] -= np.outer(view[:3, 3], v_center)
        gradients = v_means, v_quats, v_scales, v_opacities, v_colors, v_view
        return *(torch.from_numpy(v) for v in gradients), None, None


def _tile_lists(
    splats: np.ndarray, order: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Depth-ordered tile lists: ranks [I], places [I], offsets [V + 1], tile_starts [tiles + 1]."""
    n_chunks = numba.get_num_threads()
    n_tiles = -(-width // kb.TILE) * -(-height // kb.TILE)
    counts, offsets = np.empty(len(order), np.int64), np.empty(len(order) + 1, np.int64)
    histogram, tile_starts = np.empty((n_chunks, n_tiles), np.int64), np.empty(n_tiles + 1, np.int64)
    kb.count_tiles(splats, order, width, height, n_chunks, counts, histogram)
    total = kb.prefix_sums(counts, histogram, offsets, tile_starts)
    ranks, places = np.empty(total, np.int32), np.empty(total, np.int32)
    kb.fill_tiles(splats, order, width, height, n_chunks, histogram, offsets, ranks, places)
    return ranks, places, offsets, tile_starts
