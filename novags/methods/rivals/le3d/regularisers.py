"""The three regularisers of LE3D, as functions of rendered maps.

    R_T    = -log(min(T + EPSILON, 1))                                        T: accumulated alpha
    R_dist = sum over u, v of H_u H_v |s_u - s_v| + 1/3 sum over u of H_u^2 (width of u in s)
    R_nf   = T_N T_F log((d_F + EPSILON) / (d_N + EPSILON))^2

each a mean over pixels. H are the blending weights of a ray in BINS bins, which are even in depth between the nearest
and the farthest Gaussian that is seen; s is 1 / depth, 0 at the near end of the bins and 1 at the far one. d and T are
depth and alpha of the nearest and of the farthest Gaussians alone. Depths are in units of length of the fit. BINS,
EPSILON, NEAREST and FARTHEST are published.
"""

import torch
from torch import Tensor

BINS = 32
# Without it, R_T is infinite where a ray meets nothing, and depths of 0 have no logarithm.
EPSILON = 1e-3
NEAREST, FARTHEST = 0.2, 1000.0  # ends that the bins keep to


def opaque(alpha: Tensor) -> Tensor:
    """R_T of alphas of any shape; a scalar."""
    return -torch.log((alpha + EPSILON).clamp_max(1)).mean()


def bin_edges(depths: Tensor) -> Tensor | None:
    """Edges of the bins [BINS + 1] for the depths [V] of the Gaussians seen; None if they do not lie apart.

    Without gradient: bins move for nobody.
    """
    if len(depths) == 0:
        return None
    ends = depths.detach().aminmax()
    near, far = ends.min.clamp_min(NEAREST), ends.max.clamp_max(FARTHEST)
    if not bool(near < far):  # all of one depth, or all nearer or farther than bins reach
        return None
    return near + (far - near) * torch.linspace(0, 1, BINS + 1).to(near)


def in_bins(depths: Tensor, edges: Tensor) -> Tensor:
    """1 in the bin of each depth [N], 0 in the others: [N, BINS]; depths beyond the bins are in the nearest one."""
    depths = depths.detach()
    place = torch.bucketize(depths, edges[1:-1].contiguous(), right=True)
    return torch.zeros_like(depths)[:, None].repeat(1, BINS).scatter_(1, place[:, None], 1.0)


def spread(histogram: Tensor, edges: Tensor) -> Tensor:
    """R_dist of histograms [..., BINS] of weights; a scalar."""
    s = (1 / edges - 1 / edges[0]) / (1 / edges[-1] - 1 / edges[0])
    middles = (s[1:] + s[:-1]) / 2
    # sums over the bins nearer than each one, twice, in the place of all pairs: products of matrices would depend on
    # the number of threads in their last bits
    nearer = middles * histogram.cumsum(-1) - (middles * histogram).cumsum(-1)
    return (histogram * (2 * nearer + s.diff() / 3 * histogram)).sum(-1).mean()


def near_far(near: tuple[Tensor, Tensor], far: tuple[Tensor, Tensor]) -> Tensor:
    """R_nf of depths and alphas of the nearest and of the farthest Gaussians, all of one shape; a scalar."""
    (depth_near, alpha_near), (depth_far, alpha_far) = near, far
    apart = torch.log((depth_far + EPSILON) / (depth_near + EPSILON))
    return (alpha_near * alpha_far * apart.square()).mean()
