"""The effects that a capture of a scene would simulate or leave out, and the bounds: the plans, before any work."""

import os
from dataclasses import replace
from pathlib import Path

from novags.testbed.console.terminal import Console, warnings_as_notes
from novags.testbed.folders.set import Source, open_source
from novags.testbed.stages.capturing import meter
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.rendering import plan_of, render_views, rig_of
from sensor_model.files.scratch import scratch
from sensor_model.plan import Plan

# Enough to know the range of brightness and the effects of light; it takes seconds.
PILOT = RenderConfig(n_views=8, width=48, height=48, spp=32, truth_samples=1)


def light_plan(config: RenderConfig, tolerance: float, console: Console) -> Plan | None:
    """The plan of the light transport; None for a folder, whose light is already rendered.

    Args:
        config: The views of a scene of the catalogue or a Mitsuba file; or of a multiview set folder.
        tolerance: Share of all light that may be wrong or missing.
        console: Where notes go.

    Raises:
        ValueError: If there is no such scene.
    """
    if os.path.isdir(config.scene):
        return None
    with warnings_as_notes(console):
        return plan_of(config, tolerance)


def sensor_plan(
    pilot: RenderConfig, config: CaptureConfig, pixels: int, console: Console, light: Plan | None = None
) -> tuple[Plan | None, dict[str, float]]:
    """The sensor's plan for a scene, and the range of its mean signal in electrons.

    Args:
        pilot: `PILOT` of a scene, which gets this coarse render; or of a multiview set folder.
        config: Camera and light.
        pixels: Of an image of the capture, if the scene is not a folder: the more there are, the rarer the defects that
            have to be simulated.
        console: Where progress goes.
        light: The plan of the light that the coarse render follows; None: it makes its own.

    Raises:
        ValueError: If there is no such scene, or it is black.
    """
    if os.path.isdir(pilot.scene):
        return _plan(open_source(Path(pilot.scene), console, config.max_size), config, None, console)
    with scratch("plan") as folder:
        render_views(folder, pilot, rig_of(pilot), light or "auto", console, sketch=True)
        rendered = replace(open_source(folder, console, config.max_size), called=f"the scene {pilot.scene}")
        return _plan(rendered, config, pixels, console)


def _plan(
    source: Source, config: CaptureConfig, pixels: int | None, console: Console
) -> tuple[Plan | None, dict[str, float]]:
    light = meter(source, config, console, pixels)
    signal_e = light.signal_e
    named = {"darkest": signal_e[0], "median": signal_e[len(signal_e) // 2], "brightest": signal_e[-1]}
    return light.plan, {name: float(value) for name, value in named.items()}
