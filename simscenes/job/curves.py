"""What accuracy costs in time: error and seconds of a small view for every setting of every knob of the renderer.

`novags pareto render` repeats this over seeds and draws the curves.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.backend import backend_of, backend_status, using_variant
from simscenes.loading.load import LoadedScene, build_scene, set_light_weights
from simscenes.render.geometry import geometry_channels
from simscenes.render.radiance import RenderedView, RenderMethod, view_seed
from simscenes.render.sensors import sensor_dict
from simscenes.render.smooth import missing, smoothed
from simscenes.scenes import default_rig
from simscenes.transport.effects import RR_USUAL
from simscenes.transport.lights import light_weights

NOISE = "relative RMSE"
MISSING = "share of all light"
N_VIEWS = 3
OWN = "Owen-Sobol"  # the sampler of our own; the others are Mitsuba's
REFERENCE_ERROR = 0.01  # relative; its square is subtracted from every squared error measured against it

Image = NDArray[np.float64]


@dataclass(frozen=True)
class Setting:
    """One way to render a view."""

    spp: int = 256
    sampler: str = OWN
    samples: str = "even"
    denoise: bool = False
    lights: str = "weighed"
    integrator: str = "path"
    max_depth: int = 8
    rr_depth: int = RR_USUAL["path"]
    color: str = "rgb"
    variant: str = "auto"


DEFAULT = Setting()
KNOBS: dict[str, tuple[Any, ...]] = {
    "spp": (16, 64, 256, 1024),
    "sampler": ("independent", "stratified", "multijitter", "ldsampler", OWN),
    "samples": ("even", "uneven"),
    "denoise": (False, True),
    "lights": ("equal", "weighed"),
    "max_depth": (2, 3, 4, 6, 8, 16, 64),
    "rr_depth": (1, 2, 3, 5, 64),
    "integrator": ("path", "volpath"),
    "color": ("rgb", "spectral"),
    "variant": ("scalar", "llvm_ad", "cuda_ad"),
}


@dataclass(frozen=True)
class TimedError:
    """One measurement: seconds of a view on the wall and of all processors, and its error."""

    seconds: float
    cpu_seconds: float
    error: float


def settings_of(knob: str) -> tuple[tuple[Any, ...], Any]:
    """The settings of a knob that work on this machine, and the default among them.

    Raises:
        ValueError: If there is no such knob.
    """
    if knob not in KNOBS:
        raise ValueError(f"knobs must be among {', '.join(KNOBS)}, got {knob!r}")
    if knob == "variant":
        return tuple(name for name in KNOBS[knob] if backend_status(name)[0]), backend_of()
    if knob == "denoise" and missing() is not None:
        return (DEFAULT.denoise,), DEFAULT.denoise
    return KNOBS[knob], getattr(DEFAULT, knob)


def unit_of(knob: str) -> str:
    """The kind of errors of a knob's settings."""
    return MISSING if knob == "max_depth" else NOISE


def integrator(mi: Any, s: Setting) -> Any:
    """The integrator of a setting."""
    return mi.load_dict({"type": s.integrator, "max_depth": s.max_depth, "rr_depth": s.rr_depth})


class SceneBench:
    """A scene of the catalogue and its references, rendered once each: `N_VIEWS` views of size x size pixels."""

    def __init__(self, scene: str, size: int, seed: int = 0) -> None:
        self.scene = scene
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

    def view(self, mi: Any, loaded: LoadedScene, s: Setting, i: int, seed: int) -> RenderedView:
        """One view, prepared to be rendered with a setting, in the scene that `ready` gives for it."""
        return RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator(mi, s), seed=seed), self.rig, i)

    def reference(self, s: Setting) -> list[Image]:
        """Deep renders of the views to a small error, in the setting's colours."""
        if s.color not in self._references:
            deep = replace(DEFAULT, max_depth=64, color=s.color)
            with self.ready(deep) as (mi, loaded):
                views = [self.view(mi, loaded, deep, i, 10**6) for i in range(N_VIEWS)]
                self._references[s.color] = [v.render(None, REFERENCE_ERROR).mean.astype(np.float64) for v in views]
        return self._references[s.color]

    def render(self, s: Setting, i: int, seed: int) -> tuple[Image, float, float]:
        """One view, its wall and processor seconds; all sensors and kernels exist before the clocks start."""
        with self.ready(s) as (mi, loaded):
            for _ in range(2):  # the first time compiles the kernels
                draw = self._prepared(mi, loaded, s, i, seed)
                start, begun = time.perf_counter(), time.process_time()
                image = draw()
                seconds, cpu = time.perf_counter() - start, time.process_time() - begun
        return image, seconds, cpu

    def _prepared(self, mi: Any, loaded: LoadedScene, s: Setting, i: int, seed: int) -> Callable[[], Image]:
        """The function that renders one view, sensors and integrators being there."""
        if s.sampler != OWN:
            settings = sensor_dict(mi, self.rig, i, loaded) | {"sampler": {"type": s.sampler, "sample_count": s.spp}}
            sensor, method = mi.load_dict(settings), integrator(mi, s)
            number = view_seed(self.rig, i, seed)

            def plain() -> Image:
                film = mi.render(loaded.scene, sensor=sensor, integrator=method, spp=s.spp, seed=number)
                return np.array(film, dtype=np.float64)[..., :3]

            return plain
        view = self.view(mi, loaded, s, i, seed)
        assert view.sensors, "made on demand, so now"

        surfaces = geometry_channels(mi, loaded, self.rig, i) if s.denoise else {}

        def drawn() -> Image:
            if s.denoise:
                radiance = view.render(s.spp, None)
                return smoothed(radiance.mean, radiance.variance, surfaces).astype(np.float64)
            view.spread(s.spp) if s.samples == "uneven" else view.render(s.spp, None)
            return view.samples.mean()

        return drawn

    def measure(self, knob: str, setting: Any, seed: int) -> TimedError:
        """A setting of a knob, the others at their defaults.

        Raises:
            ValueError: If there is no such knob.
        """
        settings_of(knob)
        chosen = replace(DEFAULT, **{knob: setting})
        if knob == "max_depth":
            return self.missing(chosen, seed)
        return self.noise(chosen, seed, "spectral" if knob == "color" else "rgb")

    def noise(self, s: Setting, seed: int, truth_in: str = "rgb") -> TimedError:
        """Seconds of a view, and its relative RMSE against the reference in RGB or in full spectra."""
        squares, spent = [], []
        for i, truth in enumerate(self.reference(replace(s, color=truth_in))):
            image, *seconds = self.render(s, i, seed)
            squares.append(((image - truth) ** 2).mean() / truth.mean() ** 2 - REFERENCE_ERROR**2)
            spent.append(seconds)
        wall, cpu = np.median(spent, 0)
        return TimedError(float(wall), float(cpu), float(np.sqrt(max(np.mean(squares), 0.0))))

    def missing(self, s: Setting, seed: int) -> TimedError:
        """Seconds of a view, and the light that its truncated paths lack: the same paths are followed to depth 64."""
        lacks, spent = [], []
        for i in range(N_VIEWS):
            image, *seconds = self.render(s, i, seed)
            deep, *_ = self.render(replace(s, max_depth=64), i, seed)
            lacks.append((deep - image).mean() / deep.mean())
            spent.append(seconds)
        wall, cpu = np.median(spent, 0)
        return TimedError(float(wall), float(cpu), float(np.mean(lacks)))
