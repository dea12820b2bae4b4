"""Pictures of a field."""

from collections.abc import Callable

import torch
from torch import Tensor

from novags.fields.box import Box
from novags.fields.evaluate import basis_of, evaluate
from novags.fields.layout import Field
from novags.fields.march import Proposal, rays_of, sampled, weights_of, without_jitter
from novags.splats.views import Views

RAYS = 8192  # that are in memory at once
EVEN = 0.25  # share of the samples spread evenly, as in training: with less, what the map does not know is missed
Shading = Callable[[Tensor, Tensor], Tensor]  # raw [R, N, K] and weights [R, N] -> colour [R, 3]


def render_field(
    field: Field, box: Box, proposal: Proposal, views: Views, shading: Shading, samples: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Image [C, H, W, 3], alpha [C, H, W] in 0..1 and expected z-depth [C, H, W], 0 where there is nothing.

    Args:
        field: The field.
        box: Where it is.
        proposal: The map that rays are sampled after.
        views: The cameras.
        shading: Colours of rays from the raw outputs of their samples; behind the field it is black.
        samples: Per ray.
    """
    c, h, w = len(views), views.height, views.width
    views, device = views.to("cpu"), views.viewmats.device
    parts = []
    for begin in range(0, c * h * w, RAYS):
        index = torch.arange(begin, min(begin + RAYS, c * h * w))
        rays = rays_of(views, index // (h * w), index % w, index // w % h)
        found = sampled(rays, box, proposal, without_jitter(len(rays), samples), EVEN)
        raw = torch.from_numpy(evaluate(field, found.positions, basis_of(rays.directions))[0])
        raw = raw.reshape(len(rays), samples, -1)
        weights = weights_of(raw[..., 0], found.widths)
        alpha = weights.sum(1)
        depth = (weights * found.distances).sum(1) * rays.forward
        depth = torch.where(alpha > 1e-6, depth / alpha.clamp_min(1e-6), 0.0)  # an empty ray has no mean depth
        parts.append(torch.cat([shading(raw, weights), alpha.clamp_max(1)[:, None], depth[:, None]], 1))
    image = torch.cat(parts).reshape(c, h, w, 5).to(device)
    return image[..., :3], image[..., 3], image[..., 4]
