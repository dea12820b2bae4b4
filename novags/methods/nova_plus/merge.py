"""Several reconstructions of one scene as one set of Gaussians."""

from collections.abc import Sequence

import torch

from novags.splats import Gaussians


def merged(sets: Sequence[Gaussians]) -> Gaussians:
    """All Gaussians of all sets, each so transparent that as many as there are sets look like one.

    o' = 1 - (1 - o)**(1 / n): n equal Gaussians in one place then hide what is behind them as one does.

    Args:
        sets: n >= 1 sets of one degree, over one another in space.
    """
    parts = [each.detach().tensors() for each in sets]
    joined = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    left = torch.nn.functional.logsigmoid(-joined["logit_opacities"].double()) / len(sets)  # ln (1 - o')
    # eps: what is fully transparent or opaque has an infinite logit
    opacities = (-torch.expm1(left)).clamp(1e-12, 1 - torch.finfo(torch.float64).eps)
    joined["logit_opacities"] = torch.logit(opacities).float()
    return Gaussians(**joined)
