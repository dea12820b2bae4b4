"""A capture of the same scene, camera and light with more views, for a run that may have had too few."""

from dataclasses import replace
from pathlib import Path

from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.set import Source, open_source
from novags.testbed.stages.capturing import camera_for, measure_light
from novags.testbed.stages.capturing import capture as take
from novags.testbed.stages.explaining.recorded import rendering_of, taking_of
from novags.testbed.stages.rendering import render

MORE = 3  # times the views of the run


def refuse_more(capture: Capture, source: Source) -> None:
    """Refuse a capture of which no other one with more views can be made.

    Raises:
        ValueError: With the reason.
    """
    told = capture.record.simulated
    if told is None or told.mean_green is None or source.views.kind != "rendered":
        raise ValueError("more views of photographs are not known")
    rendering_of(source)
    taking_of(capture)


def make_more(capture: Capture, source: Source, folder: Path, console: Console) -> None:
    """Render and take `MORE` times the views, into `folder`/set and `folder`/capture; finished ones are kept.

    Every picture has the exposure that is common to those of the first capture, and differs from it likewise.
    """
    told = capture.record.simulated
    assert told is not None
    assert told.mean_green is not None
    config = replace(rendering_of(source), n_views=MORE * len(source.views), truth_samples=1.0)
    render(folder / "set", config, console, overwrite=True)
    taken = taking_of(capture)
    lit = open_source(folder / "set", console, taken.max_size)
    green, _ = measure_light(lit, camera_for(lit, taken), lambda *_: None)
    taken = replace(taken, electrons=told.electrons * green / told.mean_green)
    take(folder / "set", folder / "capture", taken, console, overwrite=True)
