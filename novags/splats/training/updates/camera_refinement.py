"""Refinement of the training cameras during a fit: six numbers for each, trained by an Adam of their own.

A twist (turn, move) turns a camera about its own three axes and moves its centre along them; moves count in scene
extents, so that a scene in other units, or in another world frame, is refined alike. All twists start at zero, where
the cameras are exactly the given ones.

No picture shows one rigid motion (and scale) of all cameras together with the scene. Gaussians that start at given
points keep it small, `pull` keeps it smaller; the rest is removed by aligning the cameras to the truth, which must be
done before poses, or renders from true test cameras, are compared. A turn that a sideways move compensates shows only
weakly: pictures agree long before that pair is right, and getting it right takes most of the iterations.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from ...raster.raster_torch import quat_to_rotmat
from ..config import CameraRefinement

# A camera is seen once in an epoch, so a memory of 1 / (1 - 0.999) visits would outlast most runs.
BETA1, BETA2 = 0.9, 0.99
EPS = 1e-15  # of no weight against any gradient; without it 0 / 0 for an entry whose gradients were all zero


@dataclass(kw_only=True)
class CameraState:
    """Twists of C cameras and their Adam moments.

    Attributes:
        twists: [C, 6], three turns in rad, then three moves in scene extents.
        first: [C, 6], mean of gradients.
        second: [C, 6], mean of squared gradients.
        visits: [C] int64, updates of each camera so far.
    """

    twists: Tensor
    first: Tensor
    second: Tensor
    visits: Tensor

    @staticmethod
    def of(viewmats: Tensor) -> "CameraState":
        """Zero twists for cameras [C, 4, 4]."""
        zeros = viewmats.new_zeros(len(viewmats), 6)
        visits = torch.zeros(len(viewmats), dtype=torch.int64, device=viewmats.device)
        return CameraState(twists=zeros, first=zeros.clone(), second=zeros.clone(), visits=visits)


def refined(viewmats: Tensor, twists: Tensor, extent: float) -> Tensor:
    """Cameras [C, 4, 4] after their twists [C, 6]; differentiable in the twists, exactly `viewmats` at zero.

    A turn w is the rotation by the unit quaternion along (1, w / 2). Its angle is 2 atan(|w| / 2), which is |w| up to
    third order; unlike the exponential map it has no special case at zero.
    """
    half = twists[:, :3] / 2
    R = quat_to_rotmat(torch.cat([torch.ones_like(half[:, :1]), half], 1))
    # the centre moves by `move` in camera axes: the world shifts by -move in them, and is then turned
    t = viewmats[:, :3, 3] - extent * twists[:, 3:]
    top = R @ torch.cat([viewmats[:, :3, :3], t[..., None]], 2)
    return torch.cat([top, viewmats[:, 3:].expand(len(top), 1, 4)], 1)


@torch.no_grad()
def move_cameras(state: CameraState, config: CameraRefinement, factor: float, good: Tensor | None = None) -> None:
    """One Adam step, in place, of the cameras that had a part in the loss: cameras with a gradient.

    Args:
        state: Its `twists.grad` [C, 6] is used up.
        config: Rates and pull.
        factor: Of both rates; 0 leaves the cameras and their moments alone.
        good: On a GPU: 0-d bool; where it is False nothing changes.
    """
    gradient, state.twists.grad = state.twists.grad, None
    if factor == 0 or gradient is None:
        return
    seen = (gradient != 0).any(1)
    seen = (seen if good is None else seen & good)[:, None]  # a choice of rows would have a GPU waited for
    g = gradient + 2 * config.pull * state.twists
    state.visits += seen[:, 0]
    n = state.visits[:, None].clamp_min(1)  # 0 / 0 for a camera that was never seen
    first = torch.lerp(state.first, g, 1 - BETA1)
    second = torch.lerp(state.second, g * g, 1 - BETA2)
    rates = gradient.new_tensor([config.rotation_rate] * 3 + [config.translation_rate] * 3)
    size = torch.sqrt(second / (1 - BETA2**n)) + EPS
    twists = state.twists - factor * rates * first / (1 - BETA1**n) / size
    for old, new in ((state.first, first), (state.second, second), (state.twists, twists)):
        old.copy_(torch.where(seen, new, old))
