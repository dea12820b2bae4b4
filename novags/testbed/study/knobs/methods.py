"""Whole reconstructions by every method that declares knobs, on a scene and noise of each seed."""

from collections.abc import Mapping
from typing import Any

from novags.methods import METHODS, chosen
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.knobs.knob import Subject
from novags.testbed.study.knobs.reconstruction import SCENE, PresetBench

PRESET = EXPERIMENTS["demo"]
SIZES = ("views", "width", "height", "spp", "points", "iterations", "denoiser_steps")  # the preset's own if not given


def measured_as(method: str) -> str:
    """The measured variant of a method: the preset's first variant of it, or the method itself if it has none."""
    return next((name for name in PRESET.methods if chosen(name).method == method), method)


def reconstruction(method: str, sizes: Mapping[str, int]) -> Subject:
    """The knobs of a method, turned in the demonstration at these sizes."""
    given: dict[str, Any] = {"n_views" if name == "views" else name: value for name, value in sizes.items()}
    base = adapted(PRESET, **given, methods=(measured_as(method),))
    bench, render, config = PresetBench(base), base.render, base.reconstruct(base.methods[0])
    parts = METHODS[method].parts
    workload = {
        "method": config.variant.name, "scene": f"{SCENE}:SEED", "views": render.n_views,
        "rendered views": render.views_worth,
        "size": f"{render.width} x {render.height}", "samples per pixel": render.spp,
        "sensor": base.capture.sensor_name, "electrons": base.capture.electrons, "points": base.points,
        **({} if parts is None else parts(config.config)),
    }  # fmt: skip
    return Subject(method, workload, bench.knobs(), bench.modules(), bench.plain)
