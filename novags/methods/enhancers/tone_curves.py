"""Tone curves: every pixel by itself, one curve a picture. Pictures are sRGB code in 0..1, [H, W, 3].

None of them can tell noise from signal. Each chooses its curve from one picture, so neighbouring views get different
curves; the parameters of a noisy picture bring its noise-free twin through the same curve.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.methods.enhancers.enhancer import EnhancerConfig
from novags.methods.enhancers.guided import check_picture, solve_gamma
from novags.methods.enhancers.rows.guided import EnhanceConfig
from novags.methods.noise import Variance
from sensor_model.isp import linear_to_srgb, srgb_to_linear

Array: TypeAlias = NDArray[np.float64]
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709
GAINS = (1e-3, 1e5)  # the gain is sought between these; the lowest 16-bit code needs 1e4 to become middle grey
DARKEST = 1e-4  # of the brightest pixel: pixels count as at least this in a log average, which one black one would end
STEPS = 60  # of a bisection: to the last bit of a float64


def _check_target(target: float) -> None:
    if not 0 < target < 1:
        raise ValueError(f"target must lie in (0, 1), got {target}")


@dataclass(frozen=True, kw_only=True)
class GammaConfig(EnhancerConfig):
    """A power law of the codes."""

    gamma: float | None = 0.2  # None: the one that brings the mean code to `target`
    target: float = 0.5

    def __post_init__(self) -> None:
        _check_target(self.target)
        if self.gamma is not None and not 0 < self.gamma < math.inf:
            raise ValueError(f"gamma must be > 0 and finite, got {self.gamma}")


@dataclass(frozen=True, kw_only=True)
class GainConfig(EnhancerConfig):
    """A factor on the linear light, as a longer exposure would give; what exceeds white is clipped."""

    target: float = 0.5  # mean code

    def __post_init__(self) -> None:
        _check_target(self.target)


@dataclass(frozen=True, kw_only=True)
class DragoConfig(EnhancerConfig):
    """Adaptive logarithmic mapping (Drago, Myszkowski, Annen, Chiba 2003)."""

    bias: float = 0.85  # b; the paper recommends 0.7 to 0.9 and uses 0.85

    def __post_init__(self) -> None:
        if not 0 < self.bias < 1:
            raise ValueError(f"bias must lie in (0, 1), got {self.bias}")


@dataclass(frozen=True, kw_only=True)
class EqualiseConfig(EnhancerConfig):
    """Histogram equalisation of the luma; it has no settings."""


def _gamma_of(code: Array, config: GammaConfig) -> Array:
    if config.gamma is not None:
        return np.array([config.gamma])
    flat = torch.from_numpy(code)[None]
    return solve_gamma(flat, EnhanceConfig(target=config.target, bisection_steps=STEPS)).numpy()


def _by_gamma(code: Array, config: GammaConfig, params: Array) -> Array:
    return code ** params[0]


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
    return np.exp(np.array([(low + high) / 2]))


def _by_gain(code: Array, config: GainConfig, params: Array) -> Array:
    return linear_to_srgb(np.minimum(params[0] * srgb_to_linear(code), 1))


def _adaptation(code: Array, config: DragoConfig) -> Array:
    """Log average and maximum of the luminance."""
    luminance = srgb_to_linear(code) @ LUMINANCE
    top = luminance.max()
    if top == 0:
        return np.zeros(2)
    return np.array([np.exp(np.log(np.maximum(luminance, DARKEST * top)).mean()), top])


def _by_drago(code: Array, config: DragoConfig, params: Array) -> Array:
    """Equation 4 of the paper with L_dmax = 100 cd/m²: the brightest pixel becomes white.

    L_d = log10(x_max + 1)^-1 · ln(x + 1) / ln(2 + 8 (x / x_max)^(ln b / ln 0.5)), x = L / L_a.
    """
    average, top = params
    if top == 0:  # a black picture has no logarithm of its own, and needs none
        return code
    light = srgb_to_linear(code)
    x, most = light @ LUMINANCE / average, top / average
    # ln(x + 1) / x, 1 in the limit: the colours are multiplied with L_d / L, which is 0 / 0 at black
    rise = np.where(x > 0, np.log1p(x) / np.where(x > 0, x, 1), 1.0)
    base = np.log(2 + 8 * (x / most) ** (math.log(config.bias) / math.log(0.5)))
    ratio = rise / base / (math.log10(most + 1) * average)
    return linear_to_srgb(np.minimum(light * ratio[..., None], 1))


def _distribution(code: Array, config: EqualiseConfig) -> Array:
    """The lumas that occur, and the share of the pixels up to each, less that of the darkest, [2, N]."""
    lumas, counts = np.unique(code @ LUMINANCE, return_counts=True)
    share = (np.cumsum(counts) - counts[0]) / max(1, counts.sum() - counts[0])
    return np.stack([lumas, lumas if len(lumas) == 1 else share])


def _by_equalisation(code: Array, config: EqualiseConfig, params: Array) -> Array:
    luma = code @ LUMINANCE
    found = np.interp(luma, *params)
    return np.minimum(code * np.where(luma > 0, found / np.where(luma > 0, luma, 1), 1)[..., None], 1)


Choose: TypeAlias = Callable[[Array, Any], Array]
Apply: TypeAlias = Callable[[Array, Any, Array], Array]


def _enhance(
    choose: Choose, apply: Apply, dark: Tensor, config: Any, params: Array | None, noise: Variance | None
) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; in float64, not differentiable."""
    check_picture(dark)
    code = dark.detach().cpu().double().numpy()
    params = choose(code, config) if params is None else params
    return torch.from_numpy(apply(code, config, params)).to(dark), params


def gamma(dark: Tensor, config: GammaConfig, params: Array | None, noise: Variance | None) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameter is the exponent [1]."""
    return _enhance(_gamma_of, _by_gamma, dark, config, params, noise)


def gain(dark: Tensor, config: GainConfig, params: Array | None, noise: Variance | None) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameter is the factor [1]."""
    return _enhance(_gain_of, _by_gain, dark, config, params, noise)


def drago(dark: Tensor, config: DragoConfig, params: Array | None, noise: Variance | None) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameters are the log average and the maximum of the luminance [2].

    Deviations from the paper: black pixels count as 1e-4 of the brightest in the log average, and the result is encoded
    by the sRGB curve, not by the paper's variant of that of Rec. 709.
    """
    return _enhance(_adaptation, _by_drago, dark, config, params, noise)


def equalise(
    dark: Tensor, config: EqualiseConfig, params: Array | None, noise: Variance | None
) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameters are the lumas and their shares [2, N].

    The luma is equalised and the three codes of a pixel are multiplied with the same ratio, which keeps its hue:
    channels equalised by themselves would all get the same histogram. A luma between two that occur gets a share
    between theirs.
    """
    return _enhance(_distribution, _by_equalisation, dark, config, params, noise)


def mean_params(params: Sequence[Array]) -> Array:
    """`Enhancer.typical` of exponents."""
    return np.mean(params, 0)


def geometric_mean_params(params: Sequence[Array]) -> Array:
    """`Enhancer.typical` of factors and luminances; of pictures some of which are black, that of the others."""
    lit = [each for each in params if each.all()]
    return np.exp(np.log(lit).mean(0)) if lit else params[0]


def mean_curve(params: Sequence[Array]) -> Array:
    """`Enhancer.typical` of equalisations: the mean of the curves."""
    lumas = np.unique(np.concatenate([each[0] for each in params]))
    return np.stack([lumas, np.mean([np.interp(lumas, *each) for each in params], 0)])
