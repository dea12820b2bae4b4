"""Colours from the outputs of a field: one function per kind, by the name that is kept with a saved field.

The last columns of `raw` are the outputs that depend on the view.
"""

from collections.abc import Callable, Mapping
from functools import partial

import torch
from torch import Tensor

BRIGHTEST = 15.0  # of the logarithm of light: beyond it an exponential overflows before long

Numbers = Mapping[str, float]


def display(raw: Tensor, weights: Tensor, numbers: Numbers) -> Tensor:
    """Colours in 0..1: sigmoids."""
    return (weights[..., None] * torch.sigmoid(raw[..., -3:])).sum(1)


def at(raw: Tensor, shading: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    """Colours of opaque surfaces with these outputs [n, K]: [n, 3]; shading: of (raw, weights)."""
    return shading(raw[:, None], raw.new_ones(len(raw), 1))


def light(raw: Tensor, weights: Tensor, numbers: Numbers) -> Tensor:
    """Linear light: exponentials, in the unit `numbers["unit"]`, times the matrix `numbers["m00"]`, ... if any.

    RawNeRF's choice (Mildenhall et al. 2022, section 4.1), for light has no upper end.
    """
    found = light_of(raw, weights)
    if "m00" in numbers:
        found = found @ found.new_tensor([[numbers[f"m{i}{j}"] for j in range(3)] for i in range(3)]).T
    return numbers["unit"] * found


def light_of(raw: Tensor, weights: Tensor) -> Tensor:
    """Linear light in units of its own."""
    return (weights[..., None] * torch.exp(raw[..., -3:].clamp_max(BRIGHTEST))).sum(1)


def retinex(raw: Tensor, weights: Tensor, numbers: Numbers) -> Tensor:
    """Reflectance times the enhanced illumination of LLNeRF; columns as in `split`."""
    reflectance, illumination, level, gamma = split(raw, numbers.get("illumination", 0.0))
    return (weights[..., None] * reflectance * brightened(illumination, level, gamma)).sum(1)


def product(raw: Tensor, weights: Tensor, numbers: Numbers) -> Tensor:
    """Reflectance times illumination, both unchanged: the dark picture again."""
    reflectance, illumination, _, _ = split(raw, numbers.get("illumination", 0.0))
    return (weights[..., None] * reflectance * illumination).sum(1)


def split(raw: Tensor, first: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Reflectance R [..., 3], illumination L [..., 1], and the numbers a [..., 1] and g [..., 3] of its enhancement.

    Of the columns density, R, a, g (which do not depend on the view) and L, all but the density through sigmoids; L is
    the sigmoid of `first` where its column is 0.
    """
    values, illumination = torch.sigmoid(raw[..., 1:8]), torch.sigmoid(raw[..., 8:9] + first)
    return values[..., :3], illumination, values[..., 3:4], values[..., 4:7]


LEAST_LEVEL = 1e-4  # beside a: a sigmoid that has gone to 0 would divide by it
SRGB_GAMMA = 2.2
# of an illumination: the power's slope at 0 has no end
DARKEST = 1e-6


def brightened(illumination: Tensor, level: Tensor, gamma: Tensor) -> Tensor:
    """L_e = (L / (a + 1e-4))^(1 / (g + 2.2)); Wang et al. 2023 (LLNeRF), equation 5."""
    return ((illumination + DARKEST) / (level + LEAST_LEVEL)) ** (1 / (gamma + SRGB_GAMMA))


SHADINGS: dict[str, Callable[[Tensor, Tensor, Numbers], Tensor]] = {
    "display": display,
    "light": light,
    "retinex": retinex,
    "product": product,
}


def shading_of(name: str, numbers: Numbers) -> Callable[[Tensor, Tensor], Tensor]:
    """The shading function of this name, with its numbers bound.

    Raises:
        ValueError: If no shading has this name.
    """
    if name not in SHADINGS:
        raise ValueError(f"unknown shading {name!r} of a field; available: {', '.join(SHADINGS)}")
    return partial(_apply, SHADINGS[name], numbers)


def _apply(
    function: Callable[[Tensor, Tensor, Numbers], Tensor], numbers: Numbers, raw: Tensor, weights: Tensor
) -> Tensor:
    return function(raw, weights, numbers)
