"""Textures are made once a process: a scene that is loaded in RGB and again in spectra shows the same ones."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ParamSpec

import numpy as np
from numpy.typing import NDArray

MOST_BYTES = 1 << 28  # of all kept results; the largest catalogue scene has 60 MB
_Arguments = ParamSpec("_Arguments")
_made: dict[str, tuple[NDArray[np.float32], Any]] = {}


def remembered(
    make: Callable[_Arguments, NDArray[np.float32]],
) -> Callable[_Arguments, NDArray[np.float32]]:
    """Keep what a function (shape, rng, ...) returned for its arguments and the state of `rng`, and the state after.

    The generator ends in the same state whether the texture was made or remembered, so that all that follows is the
    same as well. The oldest are forgotten first.
    """

    @functools.wraps(make)
    def known(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> NDArray[np.float32]:
        rng = next(a for a in args if isinstance(a, np.random.Generator))
        rest = [a for a in args if a is not rng]
        key = repr((make.__name__, rest, sorted(kwargs.items()), rng.bit_generator.state))
        if key not in _made:
            texels = make(*args, **kwargs)
            _made[key] = (texels.copy(), rng.bit_generator.state)
            while sum(kept.nbytes for kept, _ in _made.values()) > MOST_BYTES:
                del _made[next(iter(_made))]
            return texels
        texels, rng.bit_generator.state = _made[key]
        return texels.copy()

    return known
