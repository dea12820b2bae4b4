"""The curve `equalise`; see `rows/equalise.py`."""

from collections.abc import Sequence

import numpy as np
from torch import Tensor

from novags.methods.enhancers.curves.curve import LUMINANCE, Array, through
from novags.methods.enhancers.rows.equalise import EqualiseConfig
from novags.methods.noise import Variance


def _distribution(code: Array, config: EqualiseConfig) -> Array:
    """The lumas that occur, and the share of the pixels up to each, less the share of the darkest, [2, N]."""
    lumas, counts = np.unique(code @ LUMINANCE, return_counts=True)
    share = (np.cumsum(counts) - counts[0]) / max(1, counts.sum() - counts[0])
    return np.stack([lumas, lumas if len(lumas) == 1 else share])


def _by_equalisation(code: Array, config: EqualiseConfig, params: Array) -> Array:
    luma = code @ LUMINANCE
    found = np.interp(luma, *params)
    return np.minimum(code * np.where(luma > 0, found / np.where(luma > 0, luma, 1), 1)[..., None], 1)


def equalise(
    dark: Tensor, config: EqualiseConfig, params: Array | None, noise: Variance | None
) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameters are the lumas and their shares [2, N].

    The luma is equalised and the three codes of a pixel are multiplied with the same ratio, which keeps its hue:
    channels equalised by themselves would all get the same histogram. A luma between two that occur gets a share
    between theirs.
    """
    return through(_distribution, _by_equalisation, dark, config, params, noise)


def mean_curve(params: Sequence[Array]) -> Array:
    """`Enhancer.typical` of equalisations: the mean of the curves."""
    lumas = np.unique(np.concatenate([each[0] for each in params]))
    return np.stack([lumas, np.mean([np.interp(lumas, *each) for each in params], 0)])
