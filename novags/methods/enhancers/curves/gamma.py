"""The curve `gamma`; see `rows/gamma.py`."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.curves.curve import STEPS, Array, through
from novags.methods.enhancers.pictures import solve_gamma
from novags.methods.enhancers.rows.gamma import GammaConfig
from novags.methods.noise import Variance


def _gamma_of(code: Array, config: GammaConfig) -> Array:
    if config.gamma is not None:
        return np.array([config.gamma])
    flat = torch.from_numpy(code)[None]
    return solve_gamma(flat, EnhanceConfig(target=config.target, bisection_steps=STEPS)).numpy()


def _by_gamma(code: Array, config: GammaConfig, params: Array) -> Array:
    return code ** params[0]


def gamma(dark: Tensor, config: GammaConfig, params: Array | None, noise: Variance | None) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameter is the exponent [1]."""
    return through(_gamma_of, _by_gamma, dark, config, params, noise)


def mean_params(params: Sequence[Array]) -> Array:
    """`Enhancer.typical` of exponents."""
    return np.mean(params, 0)
