"""The dark pictures, enhanced as the paper does."""

import numpy as np
import torch
from torch import Tensor

from novags.methods.enhancers import guided
from novags.testbed.stages.seen.raw import codes


def pictures(dark: Tensor, seed: int) -> np.ndarray:
    """As `SEEN` says."""
    return codes(enhanced(dark))


def enhanced(dark: Tensor) -> Tensor:
    """The enhanced pictures [C, h, w, 3]."""
    return torch.stack([guided.enhance(view)[0] for view in dark])
