"""The readable rasteriser: dense, differentiable, any float dtype. It is the truth the fast kernels are tested against.

Every pixel looks at every visible Gaussian in depth order, so cost is pixels x Gaussians. Use it for checking only.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from ..sh import sh_colors
from .info import Projected, Watch

ALPHA_MIN = 1.0 / 255.0  # a contribution below one 8-bit step is skipped
ALPHA_MAX = 0.999  # an opaque Gaussian would divide by 1 - alpha = 0 in the backward pass
TRANSMITTANCE_MIN = 1e-4  # a pixel stops before its transmittance would fall below this
PIXELS_PER_CHUNK = 4096  # bounds memory: chunk x Gaussians numbers live at once


def unit_largest(quats: Tensor) -> Tensor:
    """The quaternions [N, 4] over their largest components: squares of long or short ones would over- or underflow."""
    # detached: values that depend on the direction alone have the same gradient with the factor held fixed
    return quats / quats.detach().abs().amax(-1, keepdim=True)


def quat_to_rotmat(quats: Tensor) -> Tensor:
    """Rotation matrices [N, 3, 3] of quaternions wxyz [N, 4] of any non-zero length."""
    w, x, y, z = torch.nn.functional.normalize(unit_largest(quats), dim=-1, eps=0.0).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def project(
    means: Tensor, quats: Tensor, scales: Tensor, viewmat: Tensor, K: Tensor, width: int, height: int, eps2d: float
) -> tuple[Tensor, Tensor, Tensor]:
    """EWA projection of 3D Gaussians into one pinhole camera (Zwicker et al. 2001, as in gsplat).

    Args:
        means: [N, 3] world positions.
        quats: [N, 4] wxyz.
        scales: [N, 3] standard deviations along the principal axes, world units.
        viewmat: [4, 4] world to camera, OpenCV axes.
        K: [3, 3] intrinsics in pixels.
        width: Image width, pixels.
        height: Image height, pixels.
        eps2d: Variance added to both image axes, px^2: a splat is never thinner than about a pixel.

    Returns:
        means2d [N, 2] in pixels, covariances2d [N, 2, 2] in px^2, depths [N] (camera z).
    """
    means2d, M, z = image_axes(means, quats, scales, viewmat, K, width, height)
    return means2d, dilated(M, eps2d), z


def image_axes(
    means: Tensor, quats: Tensor, scales: Tensor, viewmat: Tensor, K: Tensor, width: int, height: int
) -> tuple[Tensor, Tensor, Tensor]:
    """As `project`, but instead of the covariances their factors M [N, 2, 3], M M^T before dilation."""
    R = viewmat[:3, :3]
    camera = means @ R.T + viewmat[:3, 3]
    x, y, z = camera.unbind(-1)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    means2d = torch.stack([fx * x / z + cx, fy * y / z + cy], dim=-1)

    # The affine approximation explodes far outside the image; gsplat evaluates it at most 15 % beyond the border.
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    tx = z * torch.clamp(x / z, -cx / fx - margin_x, (width - cx) / fx + margin_x)
    ty = z * torch.clamp(y / z, -cy / fy - margin_y, (height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    J = torch.stack([fx / z, zero, -fx * tx / z**2, zero, fy / z, -fy * ty / z**2], dim=-1).reshape(-1, 2, 3)

    return means2d, J @ R @ (quat_to_rotmat(quats) * scales[:, None, :]), z


def dilated(M: Tensor, eps2d: float) -> Tensor:
    """Covariances M M^T + eps2d [N, 2, 2], px^2."""
    return M @ M.mT + eps2d * torch.eye(2, dtype=M.dtype, device=M.device)


def compensation(M: Tensor, eps2d: float) -> Tensor:
    """sqrt(det / det dilated) [N] of the covariances M M^T, by which opacities fall where a splat is dilated.

    Mip-Splatting (Yu et al. 2024), eq. 9, with the dilation of gsplat. 0 for a flat Gaussian seen edge on.
    """
    det = torch.linalg.cross(M[:, 0], M[:, 1]).square().sum(-1)  # c_xx c_yy - c_xy^2 has no digits left for needles
    return torch.sqrt(det / (det + eps2d * (M.square().sum((1, 2)) + eps2d)))


def _radii(means2d: Tensor, covs2d: Tensor, opacities: Tensor, width: int, height: int) -> Tensor:
    """Pixels [N, 2] a Gaussian reaches along x and y before its alpha falls below ALPHA_MIN; 0 if not in the image."""
    reach = torch.sqrt(2 * torch.log(opacities / ALPHA_MIN))
    extent = reach[:, None] * torch.sqrt(torch.diagonal(covs2d, dim1=-2, dim2=-1))
    low, high = means2d - extent, means2d + extent
    inside = (high[:, 0] > 0) & (low[:, 0] < width) & (high[:, 1] > 0) & (low[:, 1] < height)
    return torch.where(inside[:, None], torch.ceil(extent).clamp(1, 2**30), 0.0).to(torch.int32)


def composite(
    means2d: Tensor,
    covs2d: Tensor,
    opacities: Tensor,
    features: Tensor,
    width: int,
    height: int,
    on_gradient: Callable[[Tensor], None] | None = None,
) -> tuple[Tensor, Tensor]:
    """Front-to-back alpha compositing of Gaussians that are already in depth order.

    Args:
        means2d: [N, 2] pixels.
        covs2d: [N, 2, 2] px^2.
        opacities: [N].
        features: [N, D].
        width: Image width.
        height: Image height.
        on_gradient: Called in the backward pass with the gradients [P, N, 2] of the centres, of P pixels at a time.

    Returns:
        Image [H, W, D] and alpha [H, W, 1] = 1 - transmittance.
    """
    dtype, device = means2d.dtype, means2d.device
    conics = torch.linalg.inv(covs2d)
    ys, xs = torch.meshgrid(torch.arange(height, device=device), torch.arange(width, device=device), indexing="ij")
    pixels = torch.stack([xs, ys], dim=-1).reshape(-1, 2).to(dtype) + 0.5
    images, alphas = [], []
    for chunk in pixels.split(PIXELS_PER_CHUNK):
        delta = chunk[:, None] - means2d  # [P, N, 2]
        if on_gradient and delta.requires_grad:
            delta.register_hook(lambda v_delta: None if v_delta is None else on_gradient(-v_delta))
        power = 0.5 * torch.einsum("pni,nij,pnj->pn", delta, conics, delta)
        alpha = torch.clamp_max(opacities * torch.exp(-power), ALPHA_MAX)
        alpha = torch.where(alpha >= ALPHA_MIN, alpha, 0.0)
        after = torch.cumprod(1 - alpha, dim=1)  # transmittance behind Gaussian n
        nothing = after.new_ones(len(chunk), 1)
        before = torch.cat([nothing, after], dim=1)[:, :-1]
        alive = after >= TRANSMITTANCE_MIN
        images.append((alpha * before * alive) @ features)
        stop = alive.sum(1, keepdim=True)  # number of composited Gaussians
        left = torch.cat([nothing, after], dim=1).gather(1, stop)
        alphas.append(1 - left)
    return torch.cat(images).reshape(height, width, -1), torch.cat(alphas).reshape(height, width, 1)


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
    """
    z = means @ viewmat[2, :3] + viewmat[2, 3]
    # Chosen before projecting: the gradient of a Gaussian in the camera plane would be 0 * inf = nan.
    chosen = torch.nonzero((z > near_plane) & (z < far_plane) & (opacities >= ALPHA_MIN))[:, 0]
    if antialiased:  # likewise: the compensation of a Gaussian seen edge on has no slope
        with torch.no_grad():
            _, M, _ = image_axes(means[chosen], quats[chosen], scales[chosen], viewmat, K, width, height)
            chosen = chosen[opacities[chosen] * compensation(M, eps2d) >= ALPHA_MIN]
    means2d, M, depths = image_axes(means[chosen], quats[chosen], scales[chosen], viewmat, K, width, height)
    covs2d = dilated(M, eps2d)
    peaks = opacities[chosen] * compensation(M, eps2d) if antialiased else opacities[chosen]
    with torch.no_grad():
        radii = _radii(means2d, covs2d, peaks, width, height)
        radii = torch.where(radii.amax(-1, keepdim=True) > radius_clip, radii, 0)
        seen = torch.nonzero(radii[:, 0])[:, 0]
        seen = seen[torch.argsort(depths[seen], stable=True)]
    index = chosen[seen]

    def everywhere(values: Tensor) -> Tensor:
        return values.new_zeros(len(means), *values.shape[1:]).index_copy(0, index, values[seen])

    def footprint() -> tuple[Tensor, Tensor, Tensor]:
        conics = torch.linalg.inv(covs2d).reshape(-1, 4)[:, (0, 1, 3)]
        return everywhere(radii), everywhere(conics), everywhere(peaks)

    def on_gradient(v_means2d: Tensor) -> None:
        if watch.wanted:
            zeros = v_means2d.new_zeros(len(means), 2)
            sums = v_means2d.sum(0), v_means2d.abs().sum(0)
            watch.add(camera, *(zeros.index_copy(0, index, total) for total in sums))

    features = []
    if with_color:
        if sh_degree is None:
            features.append(colors[index])
        else:
            center = -viewmat[:3, :3].T @ viewmat[:3, 3]
            features.append(sh_colors(sh_degree, means[index] - center, colors[index]))
    if with_depth:
        features.append(depths[seen, None])
    image, alpha = composite(
        means2d[seen], covs2d[seen], peaks[seen], torch.cat(features, 1), width, height, on_gradient
    )
    return (
        image,
        alpha,
        Projected(
            means2d=everywhere(means2d), radius=everywhere(radii.amax(-1)), depths=z.detach(), footprint=footprint
        ),
    )
