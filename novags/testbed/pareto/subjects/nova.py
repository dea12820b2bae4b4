"""The knobs of a whole reconstruction: those of the preset demo's first method, on a scene and noise of each seed."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from novags.methods import METHODS
from novags.testbed.console import Console
from novags.testbed.pareto.knob import Subject
from novags.testbed.pareto.reconstruction import SCENE, Bench, Row
from novags.testbed.presets import EXPERIMENTS, adapted

PRESET = EXPERIMENTS["demo"]
# As many points a pixel as in the preset, and a third of its iterations and steps: a setting in half a minute.
SIZE: Mapping[str, Any] = {
    "width": 64, "height": 64, "points": 3200, "n_views": 16, "iterations": 800, "denoiser_steps": 128,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "width": 48, "height": 48, "points": 1800, "n_views": 9, "spp": 32, "iterations": 160, "denoiser_steps": 40,
}  # fmt: skip

KNOBS: dict[str, Row] = {
    "iterations": Row(
        (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0), "as many as let the whole demonstration take four minutes; the preset has "
        "three times as many", option="iterations", parts=("fit",),
    ),
    "points": Row(
        (1 / 8, 1 / 4, 1 / 2, 1.0, 2.0), "Gaussians; 0.8 for each pixel of a view, as in the preset", option="points",
        parts=("fit",),
    ),
    "denoiser steps": Row(
        (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0), "before the fit, on small crops; the preset has three times as many, which "
        "is a third of the time of its method", option="denoiser_steps", parts=("denoiser",),
    ),
    "denoiser cadence": Row(
        (None, 64, 16), "fit iterations between two more steps of the denoiser; none trains it before the fit alone",
        setting="denoiser.denoise_every", parts=("fit",),
    ),
    "mask share": Row(
        (0.05, 0.2, 0.5), "share of the pixels that are blinded in a step of the denoiser; no setting costs more",
        setting="denoiser.blind_spots.mask_fraction", parts=("denoiser",),
    ),
    "consistency": Row(
        (64, 16, 4), "fit iterations between two evaluations of the geometric term, each a second rendering",
        setting="consistency.every", parts=("fit",),
    ),
    "samples per pixel": Row(
        (1 / 16, 1 / 4, 1.0), "of the rendered truth, which is scored against too", option="spp", parts=("render",)
    ),
    "resolution": Row(
        (1 / 2, 0.71, 1.0), "width and height of render, pictures and fit; scored at the full size", option="size",
        parts=("render", "fit"),
    ),
}  # fmt: skip


def nova(small: bool, folder: Path, console: Console) -> Subject:
    """Whole reconstructions; sets and captures of each seed are kept in `folder`."""
    base = adapted(PRESET, **{**SIZE, **(SMALL if small else {}), "methods": PRESET.methods[:1]})
    bench, render, config = Bench(base, folder), base.render, base.reconstruct(base.methods[0])
    parts = METHODS[config.variant.method].parts
    workload = {
        "method": config.variant.name, "scene": f"{SCENE}:SEED", "views": render.n_views,
        "size": f"{render.width} x {render.height}", "samples per pixel": render.spp,
        "sensor": base.capture.sensor_name, "electrons": base.capture.electrons, "points": base.points,
        **({} if parts is None else parts(config.config)),
    }  # fmt: skip
    return Subject(nova.__name__, workload, tuple(bench.knob(name, row) for name, row in KNOBS.items()))
