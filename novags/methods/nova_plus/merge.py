"""Several reconstructions of one scene as one set of Gaussians."""

from collections.abc import Sequence

import torch

from novags.splats.gaussians import Gaussians
from novags.splats.training.updates.mcmc import relocation

INSIDE = (1e-12, 1 - torch.finfo(torch.float64).eps)  # an opacity of 0 or 1 has an infinite logit


def merged(sets: Sequence[Gaussians]) -> Gaussians:
    """All Gaussians of all n sets, each thinned so that n copies of it in one place look like the original.

    3DGS-MCMC does the same with copies of a Gaussian: see `relocation`.

    Args:
        sets: n >= 1 sets of one SH degree, in one world frame.
    """
    parts = [each.detach().tensors() for each in sets]
    joined = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    opacities = torch.sigmoid(joined["logit_opacities"].double()).clamp(*INSIDE)
    thinned, factors = relocation(opacities, torch.full(opacities.shape, len(sets)).to(opacities.device))
    joined["logit_opacities"] = torch.logit(thinned.clamp(*INSIDE)).float()
    joined["log_scales"] = joined["log_scales"] + torch.log(factors).float()[:, None]
    return Gaussians(**joined)
