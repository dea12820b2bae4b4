"""The Gaussians every method starts from, so that methods differ only in their targets and losses."""

from collections.abc import Iterable

import torch
from torch import Tensor

from novags.methods.problem import Start
from novags.splats.gaussians import Gaussians


def brightened(colors: Tensor, dark: Tensor, targets: Iterable[Tensor]) -> Tensor:
    """Colours of the dark images as the targets show them: per channel, the mean target over pixels of equal dark code.

    Args:
        colors: [P, 3], 0..1, taken from the dark images.
        dark: [C, H, W, 3], 0..1.
        targets: C pictures [H, W, 3], 0..1, of the same views.

    Returns:
        [P, 3], 0..1.
    """
    bins = 256
    found = torch.empty_like(colors)
    total, count = torch.zeros(3, bins, dtype=torch.float64), torch.zeros(3, bins, dtype=torch.int64)
    for picture, target in zip(dark, targets, strict=True):
        for c in range(3):
            index = (picture[..., c].cpu().flatten() * (bins - 1)).round().long()
            total[c].index_add_(0, index, target[..., c].detach().cpu().flatten().double())
            count[c] += torch.bincount(index, minlength=bins)
    for c in range(3):
        seen = count[c].nonzero()[:, 0]
        table = total[c][seen] / count[c][seen]
        # Codes no pixel has (averaged colours fall between two) take the value of the next code that occurs.
        wanted = (colors[:, c] * (bins - 1)).round().long()
        found[:, c] = table[torch.searchsorted(seen, wanted).clamp_max(len(seen) - 1)].to(colors.dtype)
    return found.clamp(0, 1)


def start_gaussians(
    init: Start, dark: Tensor, targets: Iterable[Tensor], *, sh_degree: int, init_scale: float
) -> Gaussians:  # fmt: skip
    """Gaussians at the initial points, coloured like the targets.

    Args:
        init: Points and their colours in the dark images.
        dark: [C, H, W, 3].
        targets: C pictures [H, W, 3], the fit's first targets.
        sh_degree: 0..3.
        init_scale: Standard deviation in units of the distance to the nearest neighbours; see Gaussians.from_points.
    """
    colors = brightened(init.colors.cpu(), dark, targets).to(dark.device)
    return Gaussians.from_points(init.points.to(colors.device), colors, sh_degree=sh_degree, init_scale=init_scale)
