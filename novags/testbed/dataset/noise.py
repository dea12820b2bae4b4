"""Noise of a data set: every capture draws its own.

A study photographs everything with the same random numbers, so that its comparisons are paired. A denoiser that is
trained and tested on such captures could learn the numbers themselves.
"""

from dataclasses import fields, replace

from novags.testbed.ledger.contents import digest
from novags.testbed.stages.configs.capturing import OwnNoiseConfig
from novags.testbed.study.cells.presets import Preset

SEEDS = 2**53  # every reader of JSON and CSV holds whole numbers up to here, also readers that take them for floats


def with_own_noise(preset: Preset, scene: str) -> Preset:
    """The preset with a seed of the noise that follows from all that tells its capture from others.

    The fixed pattern is the camera's, and stays.

    Args:
        preset: Of one capture.
        scene: The rendered scene, by a name that no other scene of the data set has.
    """
    given = {field.name: getattr(preset.capture, field.name) for field in fields(preset.capture) if field.init}
    told = {"scene": scene, "render": preset.render.resolved(), "capture": preset.capture.resolved()}
    return replace(preset, capture=OwnNoiseConfig(**given, drawn=int(digest(told), 16) % SEEDS))
