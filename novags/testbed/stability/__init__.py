"""Hard cases of every part, each with the error it may have: float32 against a reference of more digits.

`novags doctor --stability` computes them here; `tests/stability` holds them to their bounds.
"""

from collections.abc import Iterator, Sequence

from novags.testbed.stability.case import Case, Measured, Part, Setting, measured, refusal
from novags.testbed.stability.parts import cameras, fields, render, score, sensor
from novags.testbed.stability.parts.methods import (
    average,
    blind_spot,
    consistency,
    denoiser,
    enhance,
    enhancers,
    long_runs,
    losses,
    nova_plus,
    raw_denoiser,
    rivals,
)
from novags.testbed.stability.parts.splats import harmonics, rasterizer, updates
from novags.testbed.stability.table import embedded, has_place, markdown

_FILES = (
    enhance, enhancers, blind_spot, denoiser, raw_denoiser, consistency, losses, nova_plus, average, rivals, fields,
    harmonics, rasterizer, updates, sensor, render, score, cameras, long_runs,
)  # fmt: skip
PARTS: dict[str, Part] = {file.PART.name: file.PART for file in _FILES}


def measure(parts: Sequence[str], *, long: bool = False) -> Iterator[Measured]:
    """Compute the cases of these parts in every setting that this machine offers; the slow ones if `long`."""
    for part in parts:
        for case in PARTS[part].cases:
            if long or not case.slow:
                for setting in case.settings():
                    yield measured(case, setting)


__all__ = [
    "PARTS",
    "Case",
    "Measured",
    "Part",
    "Setting",
    "embedded",
    "has_place",
    "markdown",
    "measure",
    "measured",
    "refusal",
]
