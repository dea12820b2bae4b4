"""Whole reconstructions by every method that declares knobs, on a scene and noise of each seed."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from novags.methods import METHODS, chosen
from novags.testbed.console.terminal import Console
from novags.testbed.pareto.knob import Subject
from novags.testbed.pareto.reconstruction import SCENE, Bench
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

PRESET = EXPERIMENTS["demo"]
# As many points a pixel and denoiser steps as in the preset, a third of its iterations: a setting in half a minute.
SIZE: Mapping[str, Any] = {
    "width": 64, "height": 64, "points": 3200, "n_views": 16, "iterations": 800, "denoiser_steps": 128,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "width": 48, "height": 48, "points": 1800, "n_views": 9, "spp": 32, "iterations": 160, "denoiser_steps": 40,
}  # fmt: skip


def with_knobs() -> list[str]:
    """The methods that declare knobs."""
    return [name for name, method in METHODS.items() if method.knobs]


def measured_as(method: str) -> str:
    """What of a method is measured: the preset's first variant of it, or the method itself if it has none."""
    return next((name for name in PRESET.methods if chosen(name).method == method), method)


def reconstruction(method: str, small: bool, folder: Path, console: Console) -> Subject:
    """The knobs of a method; sets and captures of each seed are kept in `folder`, for all methods alike."""
    base = adapted(PRESET, **{**SIZE, **(SMALL if small else {}), "methods": (measured_as(method),)})
    bench, render, config = Bench(base, folder), base.render, base.reconstruct(base.methods[0])
    parts = METHODS[method].parts
    workload = {
        "method": config.variant.name, "scene": f"{SCENE}:SEED", "views": render.n_views,
        "size": f"{render.width} x {render.height}", "samples per pixel": render.spp,
        "sensor": base.capture.sensor_name, "electrons": base.capture.electrons, "points": base.points,
        **({} if parts is None else parts(config.config)),
    }  # fmt: skip
    return Subject(method, workload, bench.knobs())
