"""The dark pictures, enhanced as the paper does."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from novags.methods.enhancers import guided
from novags.testbed.stages.seen.raw import codes


def pictures(dark: Sequence[Tensor], seed: int) -> Iterator[NDArray[np.uint8]]:
    """As `SEEN` says."""
    return (codes(enhanced(view)) for view in dark)


def enhanced(view: Tensor) -> Tensor:
    """One enhanced picture [h, w, 3]."""
    return guided.enhance(view)[0]
