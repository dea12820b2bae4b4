"""No enhancement: the picture unchanged."""

from typing import TYPE_CHECKING, Any

from novags.methods.enhancers.enhancer import Enhancer

if TYPE_CHECKING:
    from torch import Tensor


def unchanged(dark: "Tensor", config: None, params: Any, noise: Any) -> "tuple[Tensor, None]":
    """As `Enhancer.enhance`."""
    return dark, None


def no_params(params: Any) -> None:
    """`Enhancer.typical`."""


ENHANCER = Enhancer(type(None), unchanged, no_params, title="the pictures as taken")
