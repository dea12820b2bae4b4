"""The curves `ase` and `ap3`; see `rows/adaptive.py`. Statistics are of the luma Y = .299 R + .587 G + .114 B of the
dark codes: its quantiles at 90 and 10 %, and its mean m.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from torch import Tensor

from novags.methods.enhancers.curves.curve import Array, mean_params, through
from novags.methods.enhancers.rows.adaptive import AdaptiveConfig, Ap3Config, AseConfig
from novags.methods.noise import Variance

LUMA = np.array([0.299, 0.587, 0.114])  # Rec. 601
CUBIC = (0.0720, -0.4376, 0.9948)  # of t³, t² and t

Adaptive = TypeVar("Adaptive", bound=AdaptiveConfig)


def statistics_of(code: Array) -> Array:
    """p90, p10 and mean of the luma of a picture [h,w,3]."""
    luma = code @ LUMA
    return np.array([*np.quantile(luma, (0.9, 0.1)), luma.mean()])


def _chosen(code: Array, config: AdaptiveConfig) -> Array:
    if config.statistics is not None:
        return np.array(config.statistics)
    if config.scene_wide:
        raise ValueError("scene_wide takes statistics of all pictures, and here is one: methods that enhance and fit "
                         "settle them (ase-gs, ap3-gs); elsewhere give statistics = [p90, p10, mean]")  # fmt: skip
    return statistics_of(code)


def _offset(config: AdaptiveConfig, p90: float, p10: float) -> float:
    return float(config.offset * (1 - p10 / p90) ** config.exponent)


def _by_ase(code: Array, config: AseConfig, params: Array) -> Array:
    p90, p10, mean = params
    if p90 == 0:  # a nearly black picture has no scale, and a division would turn its few lit pixels white
        return code
    offset = _offset(config, p90, p10)
    return offset + (1 - offset) * (1 - np.exp(-(config.slope + config.gain * mean) * code / p90))


def _by_ap3(code: Array, config: Ap3Config, params: Array) -> Array:
    p90, p10, mean = params
    if p90 == 0:
        return code
    t, (cube, square, line) = code / p90, CUBIC
    rise = (1 + config.gain * mean) * (cube * t**3 + square * t**2 + line * t)
    return np.clip(_offset(config, p90, p10) + rise, 0.0, 1.0)


def ase(dark: Tensor, config: AseConfig, params: Array | None, noise: Variance | None) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameters are p90, p10 and the mean luma [3]."""
    return through(_chosen, _by_ase, dark, config, params, noise)


def ap3(dark: Tensor, config: Ap3Config, params: Array | None, noise: Variance | None) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameters are p90, p10 and the mean luma [3]."""
    return through(_chosen, _by_ap3, dark, config, params, noise)


def settled(pictures: Iterable[Tensor], config: Adaptive) -> Adaptive:
    """`Enhancer.settled`: with the mean statistics of the pictures [H, W, 3], where they are wanted and not given."""
    if not config.scene_wide or config.statistics is not None:
        return config
    p90, p10, mean = mean_params([statistics_of(one.detach().cpu().double().numpy()) for one in pictures]).tolist()
    return replace(config, statistics=(p90, p10, mean)) if p90 > 0 else replace(config, scene_wide=False)
