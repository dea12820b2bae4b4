"""From which path length Russian roulette pays: shorter paths against more noise, both measured by pilots.

A decision by seconds would vary from run to run, and so would the pixels; the number of surfaces that paths meet does
not vary. Several paths of a pixel are traced side by side, until the last of them ends: time follows the longest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.loading.load import LoadedScene
from simscenes.render.geometry import first_surfaces, pixel_rays
from simscenes.render.radiance import view_seed
from simscenes.render.sensors import sensor_dict
from simscenes.render.wavefront import sample_sums
from simscenes.rigs import Rig
from simscenes.transport.lengths import MOST_SURVIVE

TOGETHER = 8  # paths of a pixel that are traced side by side: the lanes of a vector
SPP = 64  # of the two renders of a pilot view, whose difference is its noise


def path_lengths(
    mi: Any, loaded: LoadedScene, rig: Rig, max_depth: int, starts: Sequence[int], seed: int
) -> NDArray[np.float64]:
    """Mean number of surfaces until the last of `TOGETHER` paths of a pixel ends, for each `rr_depth` of `starts`.

    In a JIT variant. Every path is followed to its end, weighted by its probability of surviving that long: Mitsuba
    divides survivors by that, so a path of throughput t has, after roulette, survived with min(t eta^2, 0.95 of the
    probability before). Media are passed as if they were empty, and their borders do not count.
    """
    import drjit as dr

    lengths = np.zeros(len(starts))
    for i in range(len(rig)):
        _, seen = first_surfaces(mi, loaded, *pixel_rays(rig, i))
        count = TOGETHER * rig.width * rig.height
        place = np.tile(np.arange(rig.width * rig.height, dtype=np.uint32), TOGETHER)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1000 * seed + i, count)
        si = dr.gather(mi.SurfaceInteraction3f, seen, mi.UInt32(place))
        through, eta, alive = mi.Color3f(1), mi.Float(1), si.is_valid()
        chances = [mi.Float(1) for _ in starts]
        for surface in range(1, max_depth):
            counts = alive & ~mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Null)
            ends = np.stack([np.array(dr.select(counts, 1 - chance, 1), dtype=np.float64) for chance in chances])
            lengths += (1 - ends.reshape(len(starts), TOGETHER, -1).prod(1)).mean(1) / len(rig)
            sample, weight = si.bsdf().sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), alive)
            through *= dr.select(alive, weight, 0)
            eta *= dr.select(alive, sample.eta, 1)
            bright = dr.max(through)
            for k, start in enumerate(starts):
                if surface >= start:
                    chances[k] = dr.minimum(bright * eta**2, MOST_SURVIVE * chances[k])
            alive &= bright > 0
            si = loaded.scene.ray_intersect(si.spawn_ray(si.to_world(sample.wo)), alive)
            alive &= si.is_valid()
            dr.eval(si, sampler, through, eta, alive, chances)
    return lengths


def path_noise(
    mi: Any, loaded: LoadedScene, rig: Rig, integrators: Sequence[dict[str, Any]], part: float, seed: int
) -> NDArray[np.float64]:
    """Squared differences between two sequences of samples in the pixels of the pilot views, [integrator, pixel].

    Args:
        mi: The mitsuba module, in a JIT variant.
        loaded: The scene.
        rig: The pilot views.
        integrators: Whose noise is wanted; they share their random numbers.
        part: Of the width of a pixel, where samples fall. A pilot's pixels are larger than a view's: their content
            varies more, and would hide the noise of the paths.
        seed: Of the samples.
    """
    first = np.zeros(rig.width * rig.height, dtype=np.int64)
    more = np.full_like(first, SPP)
    found = []
    for integrator in integrators:
        method, squares = mi.load_dict(integrator), []
        for i in range(len(rig)):
            sensor = mi.load_dict(sensor_dict(mi, rig, i, loaded))
            seeds = [view_seed(rig, i, seed, half) for half in range(2)]
            parts = sample_sums(mi, loaded.scene, sensor, method, first, more, seeds, part)
            one, other = np.concatenate([sums for _, sums in parts], axis=1) / SPP
            squares.append(np.square(one - other).mean(-1))
        found.append(np.concatenate(squares))
    return np.stack(found)


def most_efficient(noise: NDArray[np.float64], lengths: NDArray[np.float64], default: int) -> int:
    """Index of the setting with the least noise times work, unless the `default` may well be as good.

    Args:
        noise: Squared differences between two seeds, [setting, pixel]; the settings share their random numbers.
        lengths: Mean surfaces until the last of some paths ends, [setting].
        default: Index of the setting that is kept unless another one's lead is three of its standard errors.
    """
    rays = 1 + 2 * lengths  # one from the camera, and from each surface one to a light and one onwards
    work = noise * rays[:, None]
    best = int(work.mean(1).argmin())
    lead = work[default] - work[best]
    return best if lead.mean() > 3 * lead.std() / np.sqrt(lead.size) else default
