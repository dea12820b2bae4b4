"""The common part of tone curves: every pixel by itself, one curve a picture. Pictures are sRGB code in 0..1, [H, W,
3].

None of them can tell noise from signal. Each chooses its curve from one picture, so neighbouring views get different
curves; the parameters of a noisy picture bring its noise-free twin through the same curve.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.methods.enhancers.pictures import check_picture
from novags.methods.noise import Variance

Array: TypeAlias = NDArray[np.float64]
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709
STEPS = 60  # of a bisection: to the last bit of a float64

Choose: TypeAlias = Callable[[Array, Any], Array]
Apply: TypeAlias = Callable[[Array, Any, Array], Array]


def through(
    choose: Choose, apply: Apply, dark: Tensor, config: Any, params: Array | None, noise: Variance | None
) -> tuple[Tensor, Array]:
    """As `Enhancer.enhance`, by a curve that is chosen and applied so; in float64, not differentiable."""
    check_picture(dark)
    code = dark.detach().cpu().double().numpy()
    params = choose(code, config) if params is None else params
    return torch.from_numpy(apply(code, config, params)).to(dark), params


def mean_params(params: Sequence[Array]) -> Array:
    """`Enhancer.typical` of quantiles and means."""
    return np.mean(params, axis=0)


def geometric_mean_params(params: Sequence[Array]) -> Array:
    """`Enhancer.typical` of factors and luminances; where some pictures are black, the mean of the others."""
    lit = [each for each in params if each.all()]
    return np.exp(np.log(lit).mean(0)) if lit else params[0]
