"""A trained network on measured pictures: electrons in, electrons without noise out."""

import torch
from torch import Tensor

from novags.methods.denoised.anscombe import Anscombe
from novags.methods.denoised.network import Network
from novags.methods.denoised.packing import turned, turned_back


def estimate(network: Network, electrons: Tensor, mask: Tensor, read_variance: Tensor) -> Tensor:
    """The network's estimate of the means, differentiable.

    Args:
        network: Trained on data whose noise has variance 1.
        electrons: [B, 3, H, W]; anything where the mask is 0.
        mask: The same shape, 1 where something was measured.
        read_variance: [3] or [B, 3], electrons**2.

    Returns:
        [B, 3, H, W], electrons; all channels, measured or not.
    """
    variance = read_variance.expand(len(electrons), 3)
    stabilised = Anscombe(variance[..., None, None])
    return stabilised.inverse(network(stabilised(electrons), mask, variance))


def estimate_all(network: Network, electrons: Tensor, mask: Tensor, read_variance: Tensor, *, turns: int) -> Tensor:
    """The mean of the estimates for `turns` of the eight flips and quarter turns, picture by picture, no gradient.

    The estimates are averaged where the noise is even, in the stabilised domain, as the network was trained there.

    Args:
        network: As for `estimate`.
        electrons: [C, 3, H, W].
        mask: [1, 3, H, W].
        read_variance: [3].
        turns: 1 to 8.

    Returns:
        [C, 3, H, W].
    """
    stabilised = Anscombe(read_variance[None, :, None, None])
    found = torch.empty_like(electrons)
    with torch.no_grad():
        for place, picture in zip(found.split(1), electrons.split(1), strict=True):
            total = torch.zeros_like(picture)
            for turn in range(turns):
                seen, marks = turned(picture, turn), turned(mask, turn)
                values = network(stabilised(seen), marks.contiguous(), read_variance[None])
                total += turned_back(values, turn)
            place.copy_(stabilised.inverse(total / turns))
    return found
