"""The dark pictures, unchanged."""

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


def pictures(dark: Sequence[Tensor], seed: int) -> Iterator[NDArray[np.uint8]]:
    """As `SEEN` says."""
    return map(codes, dark)


def codes(images: Tensor) -> NDArray[np.uint8]:
    """Images 0..1 as 8-bit codes."""
    found: NDArray[np.uint8] = (images.clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    return found
