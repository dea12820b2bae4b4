"""The Gaussians every method starts from, so that methods differ only in their targets and losses."""

import torch
from torch import Tensor

from novags.methods.problem import Start
from novags.splats.gaussians import Gaussians


def brightened(colors: Tensor, dark: Tensor, targets: Tensor) -> Tensor:
    """Colours of the dark images as the targets show them: per channel, the mean target over pixels of equal dark code.

    Args:
        colors: [P, 3], 0..1, taken from the dark images.
        dark: [C, H, W, 3], 0..1.
        targets: [C, H, W, 3], 0..1, the same views.

    Returns:
        [P, 3], 0..1.
    """
    bins = 256
    found = torch.empty_like(colors)
    for c in range(3):
        total, count = torch.zeros(bins, dtype=torch.float64), torch.zeros(bins, dtype=torch.int64)
        for picture, target in zip(dark[..., c], targets[..., c], strict=True):  # indices take twice a picture's memory
            index = (picture.flatten() * (bins - 1)).round().long()
            total.index_add_(0, index, target.flatten().double())
            count += torch.bincount(index, minlength=bins)
        seen = count.nonzero()[:, 0]
        table = total[seen] / count[seen]
        # Codes no pixel has (averaged colours fall between two) take the value of the next code that occurs.
        wanted = (colors[:, c] * (bins - 1)).round().long()
        found[:, c] = table[torch.searchsorted(seen, wanted).clamp_max(len(seen) - 1)].to(colors.dtype)
    return found.clamp(0, 1)


def start_gaussians(init: Start, dark: Tensor, targets: Tensor, *, sh_degree: int, init_scale: float) -> Gaussians:
    """Gaussians at the initial points, coloured like the targets.

    Args:
        init: Points and their colours in the dark images.
        dark: [C, H, W, 3].
        targets: [C, H, W, 3], the fit's first targets.
        sh_degree: 0..3.
        init_scale: Standard deviation in units of the distance to the nearest neighbours; see Gaussians.from_points.
    """
    device = targets.device
    colors = brightened(init.colors.cpu(), dark.cpu(), targets.detach().cpu())
    return Gaussians.from_points(init.points.to(device), colors.to(device), sh_degree=sh_degree, init_scale=init_scale)
