"""A capture of the same scene, camera and light with more views, for a run that may have had too few."""

from dataclasses import replace
from pathlib import Path

from novags.methods.variant import dotted
from novags.settings import changed
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.set import Source, open_source
from novags.testbed.stages.capturing import camera_for, measure_light
from novags.testbed.stages.capturing import capture as take
from novags.testbed.stages.configs.capturing import AS_ONE, CaptureConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.rendering import render
from sensor_model.presets import PRESETS
from simscenes.scenes import SCENES

MORE = 3  # times the views of the run


def refuse_more(capture: Capture, source: Source) -> None:
    """Refuse a capture of which no other one with more views can be made.

    Raises:
        ValueError: With the reason.
    """
    told = capture.record.simulated
    made = source.views.meta.get("stage") or {}
    scene = str((made.get("config") or {}).get("scene", ""))
    if told is None or told.mean_green is None or source.views.kind != "rendered":
        raise ValueError("more views of photographs are not known")
    if scene.partition(":")[0] not in SCENES:
        raise ValueError("more views are rendered of scenes of the catalogue alone")
    if capture.record.sensor_name not in PRESETS or "dark_frames" in capture.record.stage["config"]:
        raise ValueError("more views are taken with cameras of the catalogue alone, without dark frames")


def make_more(capture: Capture, source: Source, folder: Path, console: Console) -> None:
    """Render and take `MORE` times the views, into `folder`/set and `folder`/capture; what is there is kept.

    Every picture has the exposure that is common to those of the first capture, and differs from it likewise.
    """
    told = capture.record.simulated
    assert told is not None
    assert told.mean_green is not None
    asked = dotted(source.views.meta["stage"]["config"])
    base = RenderConfig(scene=asked.pop("scene"))
    config = changed(base, {**asked, "n_views": MORE * len(source.views), "truth_samples": 1.0})
    render(folder / "set", config, console, overwrite=True)
    of = dotted(capture.record.stage["config"])
    kept = ("sensor", "time", "seed", "max_size", "demosaic", "jpeg_quality", "tolerance", *AS_ONE)
    taken = changed(CaptureConfig(sensor=of["sensor"]), {name: of[name] for name in kept if name in of})
    lit = open_source(folder / "set", console, taken.max_size)
    green, _ = measure_light(lit, camera_for(lit, taken), lambda *_: None)
    taken = replace(taken, electrons=told.electrons * green / told.mean_green)
    take(folder / "set", folder / "capture", taken, console, overwrite=True)
