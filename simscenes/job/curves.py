"""What accuracy costs in time: error against seconds for every knob of the renderer."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.backend import backend_of, backend_status, using_variant
from simscenes.loading.load import LoadedScene, build_scene, set_light_weights
from simscenes.render.blocks import Blocks
from simscenes.render.passes import Passes
from simscenes.render.radiance import Method, View
from simscenes.render.sensors import PILOT_SPP, sensor_dict
from simscenes.scenes import default_rig
from simscenes.transport.lights import light_weights
from simscenes.transport.pilot import RR_DEPTH

NOISE = "relative RMSE"
MISSING = "share of all light"
N_VIEWS = 3
REFERENCE_ERROR = 0.01  # relative; its square is subtracted from every squared error measured against it

Image = NDArray[np.float64]


@dataclass(frozen=True)
class Setting:
    """One way to render a view."""

    spp: int = 256
    sampler: str = "multijitter"
    samples: str = "even"
    lights: str = "weighed"
    integrator: str = "path"
    max_depth: int = 8
    rr_depth: int = RR_DEPTH
    color: str = "rgb"
    variant: str = "auto"


DEFAULT = Setting()
KNOBS: dict[str, tuple[Any, ...]] = {
    "spp": (16, 64, 256, 1024),
    "sampler": ("independent", "stratified", "multijitter", "ldsampler"),
    "samples": ("even", "uneven"),
    "lights": ("equal", "weighed"),
    "max_depth": (2, 3, 4, 6, 8, 16, 64),
    "rr_depth": (1, 2, 3, 5, 64),
    "integrator": ("path", "volpath"),
    "color": ("rgb", "spectral"),
    "variant": ("scalar", "llvm_ad", "cuda_ad"),
}


class Bench:
    """A scene and its references, rendered once."""

    def __init__(self, scene: str, size: int, repeats: int, seed: int = 0) -> None:
        self.scene, self.repeats, self.seed = scene, repeats, seed
        self.rig = default_rig(scene, N_VIEWS, size, size)
        self._loaded: dict[str, LoadedScene] = {}
        self._references: dict[str, list[Image]] = {}
        with self.ready(replace(DEFAULT, lights="equal")) as (mi, loaded):
            self.weights = light_weights(mi, loaded, self.rig, seed)

    @contextmanager
    def ready(self, s: Setting) -> Iterator[tuple[Any, LoadedScene]]:
        """Mitsuba and the scene in a setting's variant, with its lights weighted or not."""
        with using_variant(backend_of(s.variant), s.color) as mi:
            if mi.variant() not in self._loaded:
                self._loaded[mi.variant()] = build_scene(self.scene, mi)
            loaded = self._loaded[mi.variant()]
            count = len(loaded.scene.emitters())
            even = tuple(1.0 / count for _ in range(count))
            set_light_weights(loaded, (self.weights or even) if s.lights == "weighed" else even, mi)
            yield mi, loaded

    def view(self, mi: Any, loaded: LoadedScene, s: Setting, i: int, seed: int) -> View:
        """One view, prepared to be rendered with a setting, in the scene that `ready` gives for it."""
        integrator = mi.load_dict({"type": s.integrator, "max_depth": s.max_depth, "rr_depth": s.rr_depth})
        view = View(Method(mi, mi.variant(), loaded, integrator, seed=seed), self.rig, i)
        settings = sensor_dict(mi, self.rig, i, loaded)
        view.sensors = [mi.load_dict({**settings, "sampler": {"type": s.sampler, "sample_count": s.spp}})]
        return view

    def reference(self, s: Setting) -> list[Image]:
        """Deep renders of the views to a small error, in the setting's colours."""
        if s.color not in self._references:
            deep = replace(DEFAULT, max_depth=64, color=s.color)
            with self.ready(deep) as (mi, loaded):
                views = [self.view(mi, loaded, deep, i, 10**6) for i in range(N_VIEWS)]
                self._references[s.color] = [v.render(None, REFERENCE_ERROR).mean.astype(np.float64) for v in views]
        return self._references[s.color]

    def render(self, s: Setting, i: int, seed: int) -> tuple[Image, float]:
        """One view with a setting, and its seconds; all sensors and kernels exist before the timing starts."""
        with self.ready(s) as (mi, loaded):
            for _ in range(2):  # the first time compiles the kernels
                view = self.view(mi, loaded, s, i, seed)
                start = time.perf_counter()
                if s.samples == "uneven":  # as towards a target: a pilot, and blocks where it saw noise
                    pilot = view.pilot
                    blocks = Blocks(pilot.passes, 0, np.full_like(pilot.shares, PILOT_SPP, dtype=np.int64))
                    view.run_blocks(blocks, blocks.lacking(s.spp, pilot.shares))
                    image = blocks.mean()
                else:
                    passes = Passes((self.rig.height, self.rig.width))
                    view.run(passes, 1, s.spp)
                    image = passes.mean
                seconds = time.perf_counter() - start
        return image, seconds

    def noise(self, s: Setting, truth_in: str = "rgb") -> dict[str, Any]:
        """Seconds of a view, and its relative RMSE against the reference in RGB or in full spectra."""
        truths = self.reference(replace(s, color=truth_in))
        errors, seconds = [], []
        for k in range(self.repeats):
            squares = []
            for i, truth in enumerate(truths):
                image, spent = self.render(s, i, self.seed + k)
                squares.append(((image - truth) ** 2).mean() / truth.mean() ** 2 - REFERENCE_ERROR**2)
                seconds.append(spent)
            errors.append(float(np.sqrt(max(np.mean(squares), 0.0))))
        return _point(seconds, errors, NOISE)

    def missing(self, s: Setting) -> dict[str, Any]:
        """Seconds of a view, and the light that its truncated paths lack: the same paths are followed to depth 64."""
        errors, seconds = [], []
        for k in range(self.repeats):
            for i in range(N_VIEWS):
                image, spent = self.render(s, i, self.seed + k)
                deep, _ = self.render(replace(s, max_depth=64), i, self.seed + k)
                errors.append(float((deep - image).mean() / deep.mean()))
                seconds.append(spent)
        return _point(seconds, errors, MISSING)


def _point(seconds: Sequence[float], errors: Sequence[float], unit: str) -> dict[str, Any]:
    return {
        "seconds": float(np.median(seconds)), "error": float(np.mean(errors)), "error_unit": unit,
        "error_sd": float(np.std(errors, ddof=1)) if len(errors) > 1 else 0.0,
    }  # fmt: skip


def render_curves(
    scene: str = "tabletop", *, size: int = 48, repeats: int = 3, knobs: Sequence[str] = tuple(KNOBS), seed: int = 0
) -> Iterator[dict[str, Any]]:
    """Measure every setting of some knobs, the others at their defaults, on three small views of a catalogue scene.

    Yields:
        {"knob", "setting", "seconds" (of one view), "error", "error_unit", "error_sd" (over repeats), "default"}.

    Raises:
        ValueError: If a knob or the scene does not exist.
    """
    if unknown := set(knobs) - set(KNOBS):
        raise ValueError(f"knobs must be among {list(KNOBS)}, got {sorted(unknown)}")
    bench = Bench(scene, size, repeats, seed)
    for knob in knobs:
        for value in KNOBS[knob]:
            if knob == "variant" and not backend_status(value)[0]:
                continue
            chosen = replace(DEFAULT, **{knob: value})
            if knob == "max_depth":
                found = bench.missing(chosen)
            else:
                found = bench.noise(chosen, "spectral" if knob == "color" else "rgb")
            default = value == (backend_of() if knob == "variant" else getattr(DEFAULT, knob))
            yield {"knob": knob, "setting": value, **found, "default": default}
