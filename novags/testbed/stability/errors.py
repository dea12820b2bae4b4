"""How far a result is from its reference."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import torch

EPS = float(np.finfo(np.float32).eps)
LARGEST = "of the largest value"  # the unit of `relative_error`


def relative_error(found: Any, wanted: Any) -> float:
    """The largest difference over the largest value of the reference; infinite where a number found is not finite.

    Args:
        found: Array or tensor of any float dtype.
        wanted: The reference, of the same shape. All zero: the difference itself is returned.

    Raises:
        ValueError: If the shapes differ, or the reference is not finite.
    """
    found, wanted = _array(found), _array(wanted)
    if found.shape != wanted.shape or not np.isfinite(wanted).all():
        raise ValueError(f"the reference must be finite and of shape {found.shape}, got {wanted.shape}")
    if not np.isfinite(found).all():
        return math.inf
    largest = float(np.abs(wanted).max(initial=0.0)) or 1.0
    return float(np.abs(found - wanted).max(initial=0.0)) / largest


def worst_error(pairs: Iterable[tuple[Any, Any]]) -> float:
    """The largest `relative_error` of pairs (found, wanted), each relative to its own largest value."""
    return max(relative_error(found, wanted) for found, wanted in pairs)


def _array(values: Any) -> np.ndarray:
    if isinstance(values, torch.Tensor):
        values = values.detach().cpu().double().numpy()
    return np.asarray(values, dtype=np.float64)
