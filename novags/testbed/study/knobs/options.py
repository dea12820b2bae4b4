"""Options of an experiment as numbers: which of them a budget may change, and the experiment with them changed."""

from collections.abc import Mapping, Sequence
from typing import Any

from novags.settings import flattened
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.study.cells.presets import Preset, adapted

# The smallest value that still makes sense.
LEAST = {"iterations": 10, "points": 100, "denoiser_steps": 1, "spp": 2, "size": 16}
OF_A_RENDER = ("spp", "size")
WORDS = {
    "iterations": "iterations", "points": "Gaussians", "denoiser_steps": "denoiser steps", "spp": "samples per pixel",
    "size": "pixels wide",
}  # fmt: skip


def values(preset: Preset) -> dict[str, int]:
    """The value of a preset for each option. An option is missing if neither its source nor any of its methods has it;
    a method whose variant decides it itself does not count.
    """
    plans = [preset.reconstruct(name) for name in preset.methods]
    found: dict[str, int | None] = {
        "iterations": _first(plans, "fit.iterations"), "points": preset.points,
        "denoiser_steps": _first(plans, "denoiser.warmup_steps"),
    }  # fmt: skip
    if preset.folder is None:
        found |= {"spp": preset.render.spp, "size": preset.render.width}
    return {name: value for name, value in found.items() if value}


def _first(plans: Sequence[ReconstructConfig], name: str) -> int | None:
    open_here = (flattened(plan.config).get(name) for plan in plans if not plan.variant.decides(name))
    return next((value for value in open_here if value), None)


def turned(preset: Preset, shares: Mapping[str, float]) -> Preset:
    """The preset with some options at shares of its own values."""
    own = values(preset)
    changed: dict[str, Any] = {name: max(1, round(own[name] * share)) for name, share in shares.items() if share != 1}
    if size := changed.pop("size", None):
        changed |= {"width": size, "height": max(LEAST["size"], round(preset.render.height * size / own["size"]))}
    return adapted(preset, **changed)
