"""How far to follow an adapted network, at each level of light: to where its squared error is least, without truth.

Adaptation minimises the error of all pixels in units of their noise, most of which bright and textured ones make, and
may pay for that in the dark, which an enhanced picture shows. With A and B the estimates of the network before and
after, for the first of two copies of the data whose noise is uncorrelated (see `recorrupted`), and y2 the second,

    E(A + s (B - A) - y2)**2 = E(A + s (B - A) - mean)**2 + a constant,

so that the share s of least error is E (B - A) (y2 - A) / E (B - A)**2, within [0, 1], over the pixels of one level.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

LEVELS = 24  # of equally many pixels


@dataclass(frozen=True)
class Blend:
    """Shares of the estimate after adaptation, by the estimate before it.

    Attributes:
        levels: Mean estimates before adaptation, rising, electrons [n].
        shares: 0..1 [n]; between the levels they are interpolated.
    """

    levels: Tensor
    shares: Tensor

    def __call__(self, before: Tensor, after: Tensor) -> Tensor:
        """The estimates together; any shape."""
        if len(self.levels) == 1:
            return torch.lerp(before, after, self.shares[0])
        at = torch.searchsorted(self.levels, before.contiguous()).clamp(1, len(self.levels) - 1)
        low, high = self.levels[at - 1], self.levels[at]
        place = ((before - low) / (high - low)).clamp(0, 1)
        return torch.lerp(before, after, torch.lerp(self.shares[at - 1], self.shares[at], place))


def best_blend(before: Tensor, after: Tensor, second: Tensor, variance: Tensor) -> Blend:
    """The shares of least error.

    Args:
        before: Estimates from the first copy of the data, of those pixels and channels that were measured [n].
        after: The same by the adapted network [n].
        second: The second copy [n].
        variance: Of the data, by which the pixels of a level are weighted [n].
    """
    order = before.argsort()
    change = (after - before) / variance
    levels, shares = list[float](), list[float]()
    for some in order.tensor_split(min(LEVELS, len(order))):
        level = float(before[some].double().mean())
        size = float((change[some] * (after - before)[some]).double().sum())
        gain = float((change[some] * (second - before)[some]).double().sum())
        share = min(max(gain / size, 0.0), 1.0) if size > 0 else 1.0
        if levels and level <= levels[-1]:  # a capture without any light has one level
            continue
        levels.append(level)
        shares.append(share)
    return Blend(before.new_tensor(levels), before.new_tensor(shares))
