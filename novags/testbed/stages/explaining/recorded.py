"""The settings of a stage from its record, with which it can be done again."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from novags.methods.variant import dotted
from novags.settings import changed
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.set import Source
from novags.testbed.ledger.contents import jsonable
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from sensor_model.presets import PRESETS
from simscenes.scenes import SCENES


def as_recorded(what: str, asked: Mapping[str, Any], make: Callable[[], Any]) -> Any:
    """The configuration that `make` builds, if it asks for the recorded settings and no others.

    Args:
        what: The name of the result, for the message.
        asked: The recorded settings.
        make: Builds a configuration with a method `resolved`.

    Raises:
        ValueError: If this version lacks a setting, or resolves the settings to others.
    """
    try:
        config = make()
    except (ValueError, KeyError) as error:
        raise ValueError(f"this version cannot make {what} again: {error}") from error
    if jsonable(config.resolved()) != asked:
        raise ValueError(f"this version does not make {what} again as it was made")
    return config


def rendering_of(source: Source) -> RenderConfig:
    """How a set was rendered.

    Raises:
        ValueError: If it shows no scene of the catalogue, or as `as_recorded`.
    """
    asked = (source.views.meta.get("stage") or {}).get("config") or {}
    scene = str(asked.get("scene", ""))
    if source.views.kind != "rendered" or scene.partition(":")[0] not in SCENES:
        raise ValueError("the set shows no scene of the catalogue")
    settings = {name: value for name, value in dotted(asked).items() if name != "scene"}
    config: RenderConfig = as_recorded("the set", asked, lambda: changed(RenderConfig(scene=scene), settings))
    return config


def taking_of(capture: Capture) -> CaptureConfig:
    """How a capture was taken.

    Raises:
        ValueError: If it holds photographs, if its camera is not in the catalogue, if it has dark frames, or as
            `as_recorded`.
    """
    asked = capture.record.stage["config"]
    if capture.imported:
        raise ValueError("the capture holds photographs")
    if capture.record.sensor_name not in PRESETS:
        raise ValueError(f"its camera, {capture.record.sensor_name}, is not in the catalogue")
    if "dark_frames" in asked:
        raise ValueError("its noise comes from dark frames")
    own = {each.name for each in fields(CaptureConfig) if each.init} - {"sensor"}
    settings = {name: value for name, value in asked.items() if name in own}
    config: CaptureConfig = as_recorded(
        "the capture", asked, lambda: changed(CaptureConfig(sensor=asked["sensor"]), settings)
    )
    return config
