"""Real spherical harmonics of degrees 0 to 3 in the sign and order conventions of the standard 3DGS PLY.

Coefficient k = l^2 + l + m multiplies Y_lm; `sh[:, 0]` is the constant (DC) term. Colours are `SH(direction) + 0.5`.
"""

import torch
from torch import Tensor

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def n_coefficients(degree: int) -> int:
    """Number of coefficients per colour channel of all degrees up to `degree`."""
    return (degree + 1) ** 2


def rgb_to_sh(rgb: Tensor) -> Tensor:
    """DC coefficient [..., 3] that makes a Gaussian show colour `rgb` [..., 3] from every direction."""
    return (rgb - 0.5) / C0


def sh_to_rgb(dc: Tensor) -> Tensor:
    """Colour [..., 3] of a DC coefficient [..., 3]; the inverse of `rgb_to_sh`."""
    return dc * C0 + 0.5


def sh_basis(degree: int, directions: Tensor) -> Tensor:
    """Basis functions at unit vectors.

    Args:
        degree: 0, 1, 2 or 3.
        directions: Unit vectors [..., 3] from the camera to the Gaussian.

    Returns:
        [..., (degree + 1)^2].

    Raises:
        ValueError: If the degree is not 0, 1, 2 or 3.
    """
    if degree not in (0, 1, 2, 3):
        raise ValueError(f"sh_degree must be 0, 1, 2 or 3, got {degree}")
    x, y, z = directions.unbind(-1)
    terms = [torch.full_like(x, C0)]
    if degree >= 1:
        terms += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        terms += [C2[0] * x * y, C2[1] * y * z, C2[2] * (2 * zz - xx - yy), C2[3] * x * z, C2[4] * (xx - yy)]
    if degree >= 3:
        terms += [
            C3[0] * y * (3 * xx - yy),
            C3[1] * x * y * z,
            C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            C3[4] * x * (4 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3 * yy),
        ]
    return torch.stack(terms, dim=-1)


def sh_colors(degree: int, directions: Tensor, sh: Tensor) -> Tensor:
    """Colours of Gaussians seen along `directions`, negative values cut at zero as in gsplat.

    Args:
        degree: Highest degree to use; further coefficients in `sh` are ignored.
        directions: [N, 3], camera centre to Gaussian, any length.
        sh: [N, K, 3] with K >= (degree + 1)^2.

    Returns:
        [N, 3], >= 0.
    """
    k = n_coefficients(degree)
    if sh.shape[-2] < k:
        raise ValueError(f"sh_degree={degree} needs colors [N, K >= {k}, 3], got K = {sh.shape[-2]}")
    # eps: a Gaussian exactly at the camera centre has no direction; without it the normalisation divides by zero.
    unit = torch.nn.functional.normalize(directions, dim=-1, eps=1e-12)
    return torch.clamp_min((sh_basis(degree, unit)[..., None] * sh[..., :k, :]).sum(-2) + 0.5, 0.0)
