"""Pictures of a field."""

from collections.abc import Callable

import torch
from torch import Tensor

from novags.fields.box import Box
from novags.fields.evaluate import basis_of, evaluate
from novags.fields.field import Field
from novags.fields.march import Proposal, rays_of, sampled, weights_of, without_jitter
from novags.splats.views import Views

RAYS = 8192  # that are in memory at once
EVEN = 0.25  # share of the samples spread evenly, as in training: with less, surfaces missing in the map are missed
Shading = Callable[[Tensor, Tensor], Tensor]  # raw [R, N, K] and weights [R, N] -> colour [R, 3]


def median_distance(weights: Tensor, distances: Tensor) -> Tensor:
    """Distance in front of which half of a ray's weight lies, [R]; 0 for rays through nothing.

    The mean, which suits Gaussians, means nothing here: rays end at many times the size of a scene, and a hundredth
    of the weight that got through a surface moves it by as much as the scene is deep.

    Args:
        weights: Of the samples [R, N]; each lies evenly between the middles of the distances to its neighbours.
        distances: Of the samples, increasing [R, N].
    """
    middles = (distances[:, 1:] + distances[:, :-1]) / 2
    edges = torch.cat([2 * distances[:, :1] - middles[:, :1], middles, 2 * distances[:, -1:] - middles[:, -1:]], 1)
    total = torch.cumsum(weights, 1)
    half = total[:, -1:] / 2
    place = torch.searchsorted(total, half).clamp_max(weights.shape[1] - 1)
    own = weights.gather(1, place)
    share = (half - total.gather(1, place) + own) / own.clamp_min(1e-12)  # an empty ray has 0 / 0
    begin, end = edges.gather(1, place), edges.gather(1, place + 1)
    found = (begin + share.clamp(0, 1) * (end - begin))[:, 0]
    return torch.where(total[:, -1] > 1e-6, found, 0.0)


def render_field(
    field: Field, box: Box, proposal: Proposal, views: Views, shading: Shading, samples: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Image [C, H, W, 3], alpha [C, H, W] in 0..1 and median z-depth [C, H, W], 0 where there is nothing.

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
        depth = median_distance(weights, found.distances) * rays.forward
        parts.append(torch.cat([shading(raw, weights), alpha.clamp_max(1)[:, None], depth[:, None]], 1))
    image = torch.cat(parts).reshape(c, h, w, 5).to(device)
    return image[..., :3], image[..., 3], image[..., 4]
