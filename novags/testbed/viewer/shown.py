"""The part of one capture that the viewer shows: its runs, its pictures, and the light that a view is exposed to
again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from novags.cameras.align import Similarity
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.memo import Memo
from novags.methods.problem import encode
from novags.methods.reconstruction import ReconstructedScene
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.references import enhanced_dark, pictured
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source, scaled_rig
from novags.testbed.report.place import Place, merged, runs_by_capture, title_of
from novags.testbed.report.rows import main_row, rows_of
from novags.testbed.report.verdict import leader
from novags.testbed.stages.capturing import measure_light
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.viewer.light import GREY, ViewerCamera
from novags.testbed.viewer.splats import Drawn, drawn, scene_of
from novags.testbed.viewer.world import World, true_from
from sensor_model.isp import srgb_to_linear
from simscenes.sets.pictures.png import read_png

KINDS = ("dark", "enhanced", "denoised", "rendered", "true")
LONGEST = 512  # px; longest side of a picture that is exposed again: larger ones would not follow the slider
SAMPLED = 32  # renderings that the mean light of a reconstruction is taken from


@dataclass(frozen=True)
class Shown:
    """A capture and its runs. Files and results are kept once read or computed."""

    title: str
    capture: Capture
    source: Source
    runs: dict[str, Run]
    world: World
    camera: ViewerCamera
    memo: Memo = field(default_factory=Memo, repr=False, compare=False)

    @cached_property
    def pair(self) -> tuple[str, str]:
        """The methods to begin with: the best by its scores, or the main one without scores; and the floor, or
        another.
        """
        rows = rows_of(self.runs)
        try:
            best = leader(Place(self.capture, self.source, self.runs, merged(self.runs)))
        except ValueError:  # not all of them are scored
            best = main_row(rows.values())
        others = sorted((name for name in rows if name != best), key=lambda name: rows[name].bound != "floor")
        return best, next(iter(others), best)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of pictures that are exposed again."""
        rig = scaled_rig(self.capture.cameras.rig, LONGEST)
        return rig.width, rig.height

    def kinds(self, name: str) -> tuple[str, ...]:
        """The kinds of picture that a run has."""
        run = self.runs[name]
        has = {
            "enhanced": run.enhancement is not None,
            "denoised": (run.path / "denoised").is_dir(),
            "true": self.source.lit_known,
        }
        return tuple(kind for kind in KINDS if has.get(kind, True))

    def picture(self, kind: str, name: str, i: int) -> np.ndarray | None:
        """A picture of view `i`, sRGB code, float32 [h,w,3] in 0..1; None where that view has none of the kind.

        Raises:
            ValueError: If a file is missing or damaged.
        """
        run, view = self.runs[name], self.capture.names[i]
        if kind == "dark":
            return self.capture.srgb8(i) if self.capture.is_dark(i) else None
        if kind == "true":
            return self.source.lit(i) if self.source.shows(i) else None
        if kind == "enhanced":
            if run.enhancement is None or not self.capture.is_dark(i):
                return None
            return enhanced_dark(self.capture, i, run.enhancement)
        if kind == "rendered":
            known = i in self.capture.cameras.test_indices or run.shows_training_views
            return self.on_screen(name, run.rendering(view)) if known else None
        path = run.path / "denoised" / f"{view}.png"
        return read_png(path) if path.is_file() else None

    def on_screen(self, name: str, image: np.ndarray) -> np.ndarray:
        """A rendering of a run as sRGB code; of one in linear light enhanced, or with its mean green at middle grey."""
        run = self.runs[name]
        if run.space != "linear" or run.enhancement is not None:
            return np.clip(pictured(run, self.capture, image), 0, 1)
        return encode(self._gain(name) * image)

    def _gain(self, name: str) -> float:
        """Factor that brings the light of a run to the screen. Black needs none, and no gain would brighten it."""
        green = self.run_green(name)
        return GREY / green if green > 0 else 1.0

    def scene(self, name: str) -> tuple[ReconstructedScene, Similarity, Drawn | None] | None:
        """A run's scene, the way from its frame to the viewer's, and the data that the browser draws, if Gaussians;
        else None.

        Raises:
            ValueError: If a file is damaged.
        """
        return self.memo.once(("scene", name), lambda: self._scene(name))

    def _scene(self, name: str) -> tuple[ReconstructedScene, Similarity, Drawn | None] | None:
        found = scene_of(self.runs[name])
        if found is None:
            return None
        into = self.world.from_true @ true_from(self.runs[name], self.capture)
        if not isinstance(found, GaussianScene):
            return found, into, None
        light = self.runs[name].space == "linear" and found.tone is None  # tones are drawn unchanged
        return found, into, drawn(found, into, self._gain(name) if light else None)

    def linear(self, name: str, image: np.ndarray) -> np.ndarray:
        """A rendering of a run as light, in a unit of the run's own.

        Of a run that does not render linear light, the light that its picture would need on a screen: the tones belong
        to the picture, not to the scene.
        """
        if self.runs[name].space == "linear":
            return np.maximum(image, 0)
        return np.asarray(srgb_to_linear(np.clip(image, 0, 1)))

    def run_green(self, name: str) -> float:
        """Mean green light of a run's renderings, in the unit of `linear`."""
        return self.memo.once(("run green", name), lambda: self._run_green(name))

    def _run_green(self, name: str) -> float:
        run, cameras = self.runs[name], self.capture.cameras
        views = range(len(cameras)) if run.shows_training_views else cameras.test_indices
        some = views[:: -(-len(views) // SAMPLED)]
        greens = [self.linear(name, run.rendering(self.capture.names[i]))[..., 1].mean() for i in some]
        return float(np.mean(greens))

    def true_light(self, i: int) -> np.ndarray:
        """Linear RGB of view `i` as the camera of the capture saw it, [h,w,3] of `size`."""
        light = self.source.radiance(i)
        if (light.shape[1], light.shape[0]) == self.size:
            return light
        import cv2

        return np.asarray(cv2.resize(light, self.size, interpolation=cv2.INTER_AREA))

    def true_green(self) -> float:
        """Mean green of `true_light` over all views: the reference of `--electrons`.

        Raises:
            ValueError: If the set is black.
        """
        return self.memo.once("true green", self._true_green)

    def _true_green(self) -> float:
        told = self.capture.record.simulated
        if told is not None and told.mean_green is not None:
            return float(told.mean_green)
        return measure_light(self.source, self.camera.sensor, lambda *_: None)[0]


def shown_of(folders: Sequence[Path], console: Console, sensor: str | None = None) -> list[Shown]:
    """The captures behind several folders of runs: one entry for each capture.

    Args:
        folders: Of runs, of experiments, or such that hold some.
        console: Where notes go.
        sensor: Name or file of the camera that views are exposed with again. None: the capture's own.

    Raises:
        ValueError: If a folder holds no run, a run no longer fits its capture, or there is no such camera.
    """
    found: list[Shown] = []
    for capture, source, runs in runs_by_capture(folders, console):
        config = None if sensor is None else CaptureConfig(sensor=sensor)
        title = title_of(capture, source)
        found.append(
            Shown(
                title=title if all(title != other.title for other in found) else f"{title} ({capture.path})",
                capture=capture,
                source=source,
                runs=runs,
                world=World.of(capture, upright=source.views.kind == "rendered"),
                camera=ViewerCamera.of(capture, source, config),
            )
        )
    return found
