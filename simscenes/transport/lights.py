"""Which lights deserve samples: shares of the visible illumination, measured before rendering.

Mitsuba picks every light equally often. Picking each as often as it matters changes no mean, only the noise: on
`bookshop`, whose window gives most of the light, the variance falls by a third, on `tabletop` by a fifth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.loading.contents import media_in
from simscenes.loading.load import LoadedScene
from simscenes.render.geometry import first_surfaces, pixel_rays
from simscenes.render.wavefront import from_numpy
from simscenes.rigs import Rig

SAMPLES = 4  # per light and pixel of the pilot views
UNIFORM = 0.1  # part of the samples spread evenly, for points where the lights rank differently
MAX_LIGHTS = 64  # with more, measuring each costs more than it saves
COARSE = 1.015  # times the least variance of the choice: the allowed cost of parts that keep samples stratified


def light_weights(mi: Any, loaded: LoadedScene, rig: Rig, seed: int) -> tuple[float, ...]:
    """How often to pick each light, relative; () where there is nothing to choose, or fog or spectra prevent measuring.

    A light's weight is the root mean square, over the surface points of the pilot views, of its share in the direct
    light there: the choice that minimises relative variance when one light is picked per point.
    """
    lights = loaded.scene.emitters()
    foggy = bool(media_in(loaded.scene, mi))
    if foggy or not 1 < len(lights) <= MAX_LIGHTS or not mi.variant().endswith("ad_rgb"):
        return ()
    light = np.concatenate([_direct_light(mi, loaded, rig, i, len(lights), seed) for i in range(len(rig))], axis=1)
    lit = light.sum(0) > 0
    if not lit.any():
        return ()
    shares = light[:, lit] / light[:, lit].sum(0)
    weight = np.sqrt((shares**2).mean(1))
    return in_even_parts((1 - UNIFORM) * weight / weight.sum() + UNIFORM / len(lights))


def in_even_parts(weights: NDArray[np.float64]) -> tuple[float, ...]:
    """Weights as whole parts of 1/2^k, each of one part at least: the coarsest that cost no more than `COARSE`.

    A light is picked by the first coordinate of a point, and the rest of that coordinate picks a place on it. Points of
    Sobol are even in cells of 1/2^k: where lights end between cells, each light's own points are not, and on two lamps
    64 samples at weights of .7 and .3 were noisier than at even ones, at .75 and .25 half as noisy.

    Args:
        weights: The best ones, positive, of sum 1.
    """
    parts = 1
    while parts < len(weights):
        parts *= 2
    while True:
        whole = np.maximum(1, np.floor(weights * parts))
        while whole.sum() != parts:  # the rest of rounding goes where it is missed most, or is taken where least
            step = 1 if whole.sum() < parts else -1
            change = np.where(whole + step < 1, np.inf, weights**2 / np.maximum(whole + step, 1) - weights**2 / whole)
            whole[change.argmin()] += step
        if parts * (weights**2 / whole).sum() <= COARSE:
            return tuple((whole / parts).tolist())
        parts *= 2


def _direct_light(mi: Any, loaded: LoadedScene, rig: Rig, i: int, count: int, seed: int) -> NDArray[np.float64]:
    """Irradiance from each light, shadows included, at the points that the pixels of view `i` show: [light, pixel]."""
    import drjit as dr

    origin, directions = pixel_rays(rig, i)
    _, seen = first_surfaces(mi, loaded, origin, directions)
    pixels = len(directions)
    wide, many = dr.opaque(mi.UInt32, pixels), dr.opaque(mi.UInt32, count)
    lane = dr.arange(mi.UInt32, SAMPLES * count * pixels)  # the pixels fastest, then the lights
    si = dr.gather(mi.SurfaceInteraction3f, seen, lane % wide)
    emitter = dr.gather(mi.EmitterPtr, loaded.scene.emitters_dr(), lane // wide % many)
    picks = np.random.default_rng([seed, i, 7]).random((2, SAMPLES * count * pixels), dtype=np.float32)
    valid = si.is_valid()
    ds, weight = emitter.sample_direction(si, mi.Point2f(*(from_numpy(mi.Float, one) for one in picks)), valid)
    valid &= ds.pdf > 0
    facing = dr.select(dr.dot(si.n, si.to_world(si.wi)) < 0, -si.n, si.n)
    cosine = dr.maximum(dr.dot(ds.d, facing), 0)
    valid &= ~loaded.scene.ray_test(si.spawn_ray_to(ds.p), valid & (cosine > 0))
    value = np.array(dr.select(valid, mi.luminance(weight, si.wavelengths) * cosine, 0), dtype=np.float64)
    return np.nan_to_num(value).reshape(SAMPLES, count, pixels).mean(0)
