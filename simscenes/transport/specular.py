"""How much light reaches the camera by two specular surfaces in a row: only there can polarisation be seen."""

from __future__ import annotations

from typing import Any

import numpy as np

from simscenes.loading.load import LoadedScene
from simscenes.render.geometry import first_surfaces, pixel_rays
from simscenes.rigs import Rig

SPECULAR = 0x8 | 0x10 | 0x20 | 0x40 | 0x80 | 0x100  # BSDFFlags: glossy and delta lobes, which polarise
SAMPLES = 16  # paths from each pixel of the pilot views


def chained_light(mi: Any, loaded: LoadedScene, rig: Rig, integrator: dict[str, Any], seed: int) -> float:
    """Mean radiance in the pilot views that two specular lobes in a row have passed on; in a JIT variant.

    The first two bounces are sampled here, lobe by lobe; what the second one sees is left to the integrator.
    """
    import drjit as dr

    method, total = mi.load_dict(integrator), 0.0
    for i in range(len(rig)):
        _, seen = first_surfaces(mi, loaded.scene, *pixel_rays(rig, i))
        count = rig.width * rig.height
        place = np.tile(np.arange(count, dtype=np.uint32), SAMPLES)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1000 * seed + i, len(place))
        si = dr.gather(mi.SurfaceInteraction3f, seen, mi.UInt32(place))
        through, chain = mi.Color3f(1), si.is_valid()
        for bounce in range(2):
            sample, weight = si.bsdf().sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), chain)
            chain &= (sample.sampled_type & SPECULAR) != 0
            through *= dr.select(chain, weight, 0)
            ray = si.spawn_ray(si.to_world(sample.wo))
            if bounce == 0:
                si = loaded.scene.ray_intersect(ray, chain)
                chain &= si.is_valid()
        light, _, _ = method.sample(loaded.scene, sampler, mi.RayDifferential3f(ray), None, chain)
        found = np.array(dr.select(chain, through * light, 0), dtype=np.float64)
        total += float(np.nan_to_num(found).mean()) / len(rig)
    return total
