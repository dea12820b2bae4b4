"""Options of an experiment as numbers: which of them a budget may change, and the experiment with them changed."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from novags.settings import flattened
from novags.testbed.budget.choice import Option
from novags.testbed.presets import Preset, adapted

# The smallest value that still makes sense.
LEAST = {"iterations": 10, "points": 100, "denoiser_steps": 1, "spp": 2, "size": 16}
OF_A_RENDER = ("spp", "size")
WORDS = {
    "iterations": "iterations", "points": "Gaussians", "denoiser_steps": "denoiser steps", "spp": "samples per pixel",
    "size": "pixels wide",
}  # fmt: skip


def values(preset: Preset) -> dict[str, int]:
    """What a preset has for each option; those that none of its methods and its source have are missing."""
    configs = [flattened(preset.reconstruct(name).config) for name in preset.methods]
    found: dict[str, int | None] = {
        "iterations": _first(configs, "fit.iterations"), "points": preset.points,
        "denoiser_steps": _first(configs, "denoiser.warmup_steps"),
    }  # fmt: skip
    if preset.folder is None:
        found |= {"spp": preset.render.spp, "size": preset.render.width}
    return {name: value for name, value in found.items() if value}


def _first(configs: Sequence[Mapping[str, Any]], name: str) -> int | None:
    return next((config[name] for config in configs if config.get(name)), None)


def open_options(
    preset: Preset, options: Mapping[str, Sequence[Option]], decided: Collection[str]
) -> dict[str, list[Option]]:
    """The options that a budget may choose, with the settings that make sense for a preset.

    Args:
        preset: The experiment.
        options: What curves know.
        decided: Options that the user has set.
    """
    own = values(preset)
    found = {
        name: [s for s in settings if s.share == 1 or own[name] * s.share >= LEAST[name]]
        for name, settings in options.items() if name in own and name not in decided
    }  # fmt: skip
    return {name: settings for name, settings in found.items() if len(settings) > 1}


def turned(preset: Preset, shares: Mapping[str, float]) -> Preset:
    """The preset with some options at shares of its own values."""
    own = values(preset)
    changed: dict[str, Any] = {name: max(1, round(own[name] * share)) for name, share in shares.items() if share != 1}
    if size := changed.pop("size", None):
        changed |= {"width": size, "height": max(LEAST["size"], round(preset.render.height * size / own["size"]))}
    return adapted(preset, **changed)
