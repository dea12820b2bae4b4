"""The curve `naka`; see `rows/naka.py`."""

import numpy as np
from torch import Tensor

from novags.methods.enhancers.curves.curve import Array, through
from novags.methods.enhancers.rows.naka import NakaConfig
from novags.methods.noise import Variance


def _ends(code: Array, config: NakaConfig) -> Array:
    response = code / (code + config.half)
    return np.array([response.min(), response.max()])


def _by_naka(code: Array, config: NakaConfig, params: Array) -> Array:
    low, high = params
    if high == low:  # one colour all over has no range to be stretched
        return code
    return np.clip((code / (code + config.half) - low) / (high - low), 0.0, 1.0)


def naka(dark: Tensor, config: NakaConfig, params: Array | None, noise: Variance | None) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameters are the least and the largest response [2]."""
    return through(_ends, _by_naka, dark, config, params, noise)
