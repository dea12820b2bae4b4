"""Bright and dark raw exposures of one view, as Dark3R's student and teacher see them (arXiv 2603.05330).

bright     float32 [3, h/2, w/2]     the brightest exposure: red, mean of both greens, blue; DN, the black level kept
dark       float32 [L, 3, h/2, w/2]  the others, each with noise of its own, from the darkest on
electrons, snr_db    float32 [L]     of the captures of the dark ones: mean signal of green, e-; `snr`, dB
bright_electrons, bright_snr_db      float32 []  of the bright one
black, white         float32 []      DN without light; DN of saturation
viewmat, K           float32 [4, 4], [3, 3]  the camera; K is of the half-size pictures

Nothing is clipped, scaled or balanced: noise around black stays on both sides of it.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from novags.testbed.dataset.recipes.denoiser import check as check_sides
from novags.testbed.dataset.recipes.packing import half_size, half_size_intrinsics
from novags.testbed.dataset.recipes.recipe import Group, Recipe, Sample
from novags.testbed.study.cells.presets import Preset


def check(presets: Sequence[Preset]) -> None:
    """Refuse cameras without a mosaic, odd sizes, and a single light level.

    Raises:
        ValueError: If there is one of these.
    """
    check_sides(presets)
    first = presets[0].capture
    if first.camera.cfa is None:
        raise ValueError(f"the sensor must have a colour filter array, which is packed, got {first.sensor_name} with "
                         "three chips: leave it out")  # fmt: skip
    levels = sorted({preset.capture.electrons for preset in presets})
    if len(levels) < 2:
        raise ValueError("electrons must have two values or more for each scene and camera, a bright one and dark "
                         f"ones, got {levels[0]:g}: add a bright one, such as 1000")  # fmt: skip


def pixel_bytes(presets: Sequence[Preset]) -> float:
    """Three numbers of float32 for each cell of four pixels."""
    return 3 * len(presets)


def samples(group: Group) -> Iterator[Sample]:
    """One of each view."""
    *darker, brightest = group.levels
    cfa, black, white = brightest.capture.levels
    assert cfa is not None  # `check`
    scalars = {
        "electrons": [level.electrons for level in darker], "snr_db": [level.snr_db for level in darker],
        "bright_electrons": brightest.electrons, "bright_snr_db": brightest.snr_db, "black": black, "white": white,
    }  # fmt: skip
    told = {"electrons": " ".join(f"{level.electrons:g}" for level in group.levels),
            "snr_db": " ".join(f"{level.snr_db:.3f}" for level in group.levels)}  # fmt: skip
    for i, name in enumerate(group.names):
        bright, *dark = (half_size(level.capture.raw(i), cfa) for level in (brightest, *darker))
        rig = group.views.rig
        cameras = {"viewmat": rig.viewmats[i], "K": half_size_intrinsics(rig.Ks[i])}
        arrays = {"bright": bright, "dark": np.stack(dark), **scalars, **cameras}
        row = {"sensor": brightest.capture.record.sensor_name, **told, "view": name}
        yield Sample(name, row, {k: np.asarray(v, np.float32) for k, v in arrays.items()})


DARK3R = Recipe(
    "a bright and several dark raw exposures of each view, half-size, black level kept", check, pixel_bytes, samples
)
