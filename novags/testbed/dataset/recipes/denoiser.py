"""Pairs for a denoiser of single raw pictures: a frame as taken, and the same frame without noise and fixed pattern.

noisy     uint16 [c, h, w]   digital numbers: c = 4 planes of a mosaic at half size (`packing`), 3 of three chips
clean     float32 [c, h, w]  the frame without noise, fixed pattern and rounding, DN
variance  float32 [c, h, w]  temporal variance of each pixel, DN**2
black, white, gain, sigma_d  float32 []  DN without light; DN of saturation; DN/e-; read noise, e-
"""

from collections.abc import Iterator, Sequence

import numpy as np

from novags.testbed.dataset.recipes.packing import SIDE, packed, planes
from novags.testbed.dataset.recipes.recipe import Group, Recipe, Sample
from novags.testbed.study.cells.presets import Preset


def check(presets: Sequence[Preset]) -> None:
    """Refuse mosaics of odd size.

    Raises:
        ValueError: If a side is odd.
    """
    first = presets[0]
    size = first.render.width, first.render.height
    if first.capture.camera.cfa is not None and any(side % 2 for side in size):
        raise ValueError(f"width and height {SIDE}, got {size[0]} x {size[1]} px: make both even")


def pixel_bytes(presets: Sequence[Preset]) -> float:
    """Two, four and four for each number that the camera measures."""
    return sum(10 * (3 if preset.capture.camera.cfa is None else 1) for preset in presets)


def samples(group: Group) -> Iterator[Sample]:
    """One of each view of each capture."""
    for level in group.levels:
        capture, sensor = level.capture, level.sensor
        cfa, black, white = capture.levels
        scalars = {"black": black, "white": white, "gain": sensor.gain, "sigma_d": sensor.sigma_d}
        for i, name in enumerate(capture.names):
            frames = {"noisy": capture.raw(i), "clean": capture.truth(i, "clean"),
                      "variance": capture.truth(i, "variance")}  # fmt: skip
            row = {"sensor": capture.record.sensor_name, "electrons": level.electrons, "snr_db": round(level.snr_db, 3),
                   "view": name}  # fmt: skip
            arrays = {kind: planes(frame) if cfa is None else packed(frame, cfa) for kind, frame in frames.items()}
            arrays |= {kind: np.asarray(value, np.float32) for kind, value in scalars.items()}
            yield Sample(f"{name}-{level.electrons:g}e", row, arrays)


DENOISER = Recipe("a raw frame as taken and the same without noise, with its variance", check, pixel_bytes, samples)
