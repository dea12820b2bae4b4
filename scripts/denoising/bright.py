"""Pairs for enhancers: a dark picture, developed to 8-bit sRGB, and the same picture well exposed, without noise."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from denoising.pairs import BAYER_SHARE, EXPOSURE, Rng, Source, random_camera
from denoising.pictures import Picture, picture
from denoising.training import CHECKED
from sensor_model import Sensor, expose, linear_to_srgb, mosaic
from sensor_model.isp import develop

DARK = (0.002, 0.08)  # mean green of a whole picture, of white: from where LOL's darkest pictures lie to a dim room
WELL_EXPOSED = 0.2  # the same of the bright one: about middle grey


@dataclass(frozen=True)
class BrightPairs:
    """A batch: dark and bright sRGB codes in 0..1, [B, 3, H, W]."""

    dark: Tensor
    bright: Tensor


def dark_and_bright(clean: Picture, camera: Sensor, level: float, seed: int) -> BrightPairs:
    """One picture, linear RGB [H, W, 3] whose mean green is 1 over its whole, as a batch of one.

    Args:
        clean: Without noise.
        camera: That takes it.
        level: Mean green of the whole, of what saturates the camera.
        seed: Of the noise.
    """
    electrons = clean.astype(np.float64) * np.asarray(camera.rgb_response) * (level * camera.capacity_e)
    photons = electrons / camera.eta
    light = photons if camera.cfa is None else mosaic(photons, camera.cfa)
    frame = expose(light, camera, EXPOSURE, seed=seed, view=0, threads=1)
    code = develop(frame, camera, demosaic="bilinear").srgb8.astype(np.float32) / 255
    lit = linear_to_srgb(np.minimum(WELL_EXPOSED * clean, 1)).astype(np.float32)
    return BrightPairs(*(torch.from_numpy(values).permute(2, 0, 1)[None] for values in (code, lit)))


def bright_batch(source: Source, rng: Rng, step: int, *, crop: int, count: int) -> BrightPairs:
    """So many pairs of crops."""
    low, high = np.log(DARK)
    made = []
    for _ in range(count):
        camera = random_camera(rng, bayer=rng.random() < BAYER_SHARE)
        clean = source.draw(rng, step, crop)
        made.append(dark_and_bright(clean, camera, float(np.exp(rng.uniform(low, high))), int(rng.integers(2**31))))
    return BrightPairs(*(torch.cat([getattr(one, name) for one in made]) for name in ("dark", "bright")))


def bright_checks(count: int, size: int) -> list[BrightPairs]:
    """Pairs of pictures that training never draws, over the range of levels, half of them behind a filter array."""
    rng, levels = np.random.default_rng(1), np.geomspace(*DARK, count)
    found = []
    for i, level in enumerate(levels):
        clean = picture(CHECKED + i, size)
        camera = random_camera(rng, bayer=i % 2 == 1)
        found.append(dark_and_bright(clean / clean[..., 1].mean(), camera, float(level), i))
    return found
