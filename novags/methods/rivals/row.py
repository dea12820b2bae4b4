"""The common part of the rows of other groups' methods."""

from collections.abc import Callable
from typing import Any

from novags.methods.enhanced.config import fit_parts
from novags.methods.memory import Memory
from novags.methods.variant import Method


def rival(
    config: Callable[[], Any], train: Any, *, title: str, color: str, source: str, memory: Memory,
    parts: Callable[[Any], dict[str, int]] = fit_parts,
) -> Method:  # fmt: skip
    """Another group's method on Gaussians; its `parts` are one fit, unless they are given."""
    return Method(
        title=title, family="3DGS", color=color, source=source, config=config, train=train, parts=parts, memory=memory
    )
