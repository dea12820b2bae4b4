"""The curve `drago`; see `rows/drago.py`."""

import math

import numpy as np
from torch import Tensor

from novags.methods.enhancers.curves.curve import LUMINANCE, Array, through
from novags.methods.enhancers.rows.drago import DragoConfig
from novags.methods.noise import Variance
from sensor_model.isp import linear_to_srgb, srgb_to_linear

DARKEST = 1e-4  # of the brightest pixel: pixels count as at least this in a log average, which one black one would end


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


def drago(dark: Tensor, config: DragoConfig, params: Array | None, noise: Variance | None) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`; the parameters are the log average and the maximum of the luminance [2].

    Deviations from the paper: black pixels count as 1e-4 of the brightest in the log average, and the result is encoded
    by the sRGB curve, not by the paper's variant of the curve of Rec. 709.
    """
    return through(_adaptation, _by_drago, dark, config, params, noise)
