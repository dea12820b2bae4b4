"""The curve `gain`; see `rows/gain.py`."""

import math

import numpy as np
from torch import Tensor

from novags.methods.enhancers.curves.curve import STEPS, Array, through
from novags.methods.enhancers.rows.gain import GainConfig
from novags.methods.noise import Variance
from sensor_model.isp import linear_to_srgb, srgb_to_linear

GAINS = (1e-3, 1e5)  # the gain is sought between these; the lowest 16-bit code needs 1e4 to become middle grey


def _gain_of(code: Array, config: GainConfig) -> Array:
    """The gain that brings the mean code to the target; of a picture that no gain brings there, the nearest end."""
    light = srgb_to_linear(code)
    low, high = np.log(GAINS)
    for _ in range(STEPS):
        middle = (low + high) / 2
        if linear_to_srgb(np.minimum(math.exp(middle) * light, 1)).mean() > config.target:
            high = middle
        else:
            low = middle
    return np.exp(np.array([middle]))


def _by_gain(code: Array, config: GainConfig, params: Array) -> Array:
    return linear_to_srgb(np.minimum(params[0] * srgb_to_linear(code), 1))


def gain(dark: Tensor, config: GainConfig, params: Array | None, noise: Variance | None) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameter is the factor [1]."""
    return through(_gain_of, _by_gain, dark, config, params, noise)
