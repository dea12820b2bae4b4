"""The method that is `naive` with another enhancement, as a row; and the parts of its training."""

from functools import partial
from pathlib import Path
from typing import Any

from novags.methods.enhanced.config import EnhancedFitConfig, fit_parts
from novags.methods.enhancers import network_of
from novags.methods.enhancers.choice import Enhancement
from novags.methods.variant import Method
from sensor_model.files.registry import Later


def parts(config: EnhancedFitConfig) -> dict[str, int]:
    """`Method.parts`: the enhancer's training on the scene, if there is one, then the fit."""
    kind = network_of(config.enhance)
    steps = 0 if kind is None else learning_steps(kind, config)
    return {"enhancer": steps, **fit_parts(config)} if steps else fit_parts(config)


def weights_of(config: EnhancedFitConfig) -> tuple[Path, ...]:
    """The files of weights that the enhancer is given."""
    return getattr(config.enhance, "weights", None) or ()


def learning_steps(kind: Any, config: EnhancedFitConfig) -> int:
    """How many steps a `networks.Kind` learns from the scene."""
    return 0 if kind.rehearsal is None or weights_of(config) else int(kind.rehearsal.steps(config.enhance))


def by_enhancer(enhance: Enhancement, title: str, color: str, source: str) -> Method:
    """A method like `naive`, with another enhancement."""
    return Method(
        title=f"{title}, then fit as naive does", family="2D + GS", color=color, source=source,
        config=partial(EnhancedFitConfig, enhance=enhance),
        train=Later("novags.methods.enhanced.enhance_then_fit:train"), parts=parts,
    )  # fmt: skip
