"""Light by the length of its path: the loss by a cut at any length, from the same paths and in one pass.

Mitsuba's path tracer has its largest length compiled into it, so that one render for every candidate takes a kernel
each, at a second or more where a scene is new. Here the same paths are followed once, and each contribution is booked
under the length at which it was found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.loading.load import LoadedScene
from simscenes.render.radiance import view_seed
from simscenes.render.sampler import sampler_class
from simscenes.render.sensors import sensor_dict
from simscenes.render.wavefront import camera_rays, from_numpy
from simscenes.rigs import Rig

SPECULAR = 0x8 | 0x10 | 0x20 | 0x40 | 0x80 | 0x100  # BSDFFlags: glossy and delta lobes, which polarise
MOST_SURVIVE = 0.95  # the largest survival probability of Mitsuba's roulette, however bright a path is
MOST_BOOKED = 1 << 25  # entries of the account at once: 128 MB


@dataclass(frozen=True)
class Lengths:
    """The light that paths of a pilot found.

    Attributes:
        light: Radiance by paths of k + 1 segments in `light[k]`, [length,2,c,h,w,3], from two independent halves of the
            samples. A lamp seen directly has one segment, direct light two.
        chained: Mean radiance that two specular lobes in a row passed on to the camera: only there can polarisation be
            seen.
    """

    light: NDArray[np.float64]
    chained: float


def light_by_length(
    mi: Any, loaded: LoadedScene, rig: Rig, longest: int, rr_depth: int, spp: int, seed: int
) -> Lengths:
    """Follow the paths of Mitsuba's `path` integrator, surfaces only, in an RGB JIT variant.

    Args:
        mi: The mitsuba module.
        loaded: The scene.
        rig: The pilot views.
        longest: Path length at which all paths end, Mitsuba's `max_depth`.
        rr_depth: Path length from which roulette may end them.
        spp: Samples per pixel, an even number.
        seed: Of the random numbers.
    """
    pixels, views = rig.width * rig.height, range(len(rig))
    sensors = [mi.load_dict(sensor_dict(mi, rig, i, loaded)) for i in views]
    seeds = [view_seed(rig, i, seed, half) for half in range(2) for i in views]
    light, chained = np.zeros((longest, 2, len(rig) * pixels, 3)), 0.0
    step = max(1, MOST_BOOKED // (3 * longest * spp))
    for start in range(0, light.shape[2], step):
        chosen = slice(start, min(start + step, light.shape[2]))
        booked, passed = _follow(mi, loaded.scene, sensors, seeds, chosen, longest, rr_depth, spp)
        light[:, :, chosen] = booked
        chained += passed / (light.shape[2] * spp)
    return Lengths(light.reshape(longest, 2, len(rig), rig.height, rig.width, 3), chained)


def _follow(
    mi: Any, scene: Any, sensors: list[Any], seeds: list[int], chosen: slice, longest: int, rr_depth: int, spp: int
) -> tuple[NDArray[np.float64], float]:
    """Mean light by length of some pixels of all views, [length,2,pixel,3], and the sum of light that specular chains
    passed on. The `seeds` are those of all views for one half of the samples, then for the other.

    All views share one launch: preparing a launch takes longer than tracing the samples of a pilot.
    """
    import drjit as dr

    count, pixels = chosen.stop - chosen.start, int(np.prod(sensors[0].film().crop_size()))
    lanes = count * spp
    # Opaque: as literals these would be compiled into the kernel.
    first, each, of_view, limit, start, width = (
        dr.opaque(mi.UInt32, n) for n in (chosen.start, spp, pixels, longest, rr_depth, lanes)
    )
    lane = dr.arange(mi.UInt32, lanes)
    place = first + lane // each
    view = place // of_view
    pixel = place - view * of_view
    number = lane % each
    half = number // (each // 2)
    every = from_numpy(mi.UInt32, np.array(seeds, dtype=np.uint32))
    seed = dr.gather(mi.UInt32, every, half * dr.opaque(mi.UInt32, len(sensors)) + view)
    sampler = sampler_class(mi, mi.variant())(pixel, number - half * (each // 2), seed)
    ray, weight = _rays(mi, sensors, sampler, pixel, view)
    # A lane's light by length, then by channel, then by lane: no two lanes meet in it.
    account = dr.zeros(mi.Float, longest * 3 * lanes)
    chain = dr.zeros(mi.Float, lanes)

    def balanced(this: Any, other: Any) -> Any:
        """Weight of one of two ways to sample a lamp, by the power heuristic; 0 where neither could find it."""
        share = this * this / (this * this + other * other)
        return dr.select(dr.isfinite(share), share, 0)

    def book(light: Any, length: Any, active: Any, passed: Any) -> None:
        """Write light down under its length, and to the specular chain if that `passed` it on."""
        for k in range(3):
            dr.scatter_add(account, light[k], ((length - 1) * 3 + k) * width + lane, active)
        dr.scatter_add(chain, (light.x + light.y + light.z) / 3, lane, active & passed)

    def bounce(
        active: Any, ray: Any, through: Any, eta: Any, length: Any, drawn: Any, before: Any, pdf: Any, delta: Any,
        lobes: Any, fresh: Any, real: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        """One surface of every path, with its random numbers in the order of Mitsuba's `path`.

        `length` is the number of segments up to the surface; `before`, `pdf` and `delta` say how the last direction was
        found; `lobes` counts the specular ones in a row, 3 being no chain, and `fresh` means that this ray ends one;
        `real` says that a surface was met which did not let the path pass.
        """
        sampler.drawn = drawn
        si = scene.ray_intersect(ray, active)

        # A lamp that the path has run into. The first light of a chain counts in full: choosing lamps is not part of
        # it.
        ds = mi.DirectionSample3f(scene, si, before)
        chosen_too = scene.pdf_emitter_direction(before, ds, active & ~delta)
        found = through * ds.emitter.eval(si, active)
        book(found * balanced(pdf, chosen_too), length, active, (lobes == 2) & ~fresh)
        dr.scatter_add(chain, (found.x + found.y + found.z) / 3, lane, active & fresh)
        onwards = active & si.is_valid() & (length < limit)

        # A lamp that is chosen.
        bsdf = si.bsdf(ray)
        lit = onwards & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        ds, chance = scene.sample_emitter_direction(si, sampler.next_2d(), True, lit)
        lit &= ds.pdf != 0
        lobe, place, towards = sampler.next_1d(), sampler.next_2d(), si.to_local(ds.d)
        value, value_pdf, sample, factor = bsdf.eval_pdf_sample(mi.BSDFContext(), si, towards, lobe, place, onwards)
        share = dr.select(ds.delta, 1, balanced(ds.pdf, value_pdf))
        book(through * value * chance * share, length + 1, lit, lobes == 2)

        # Onwards. A boundary that does not bend the path neither continues a chain nor ends it.
        passes = (sample.sampled_type & int(mi.BSDFFlags.Null)) != 0
        links = (sample.sampled_type & SPECULAR) != 0
        fresh = ~passes & links & (lobes == 1)
        real |= active & si.is_valid() & ~passes
        lobes = dr.select(passes | (lobes >= 2), lobes, dr.select(links, lobes + 1, 3))
        through, eta, length = through * factor, eta * sample.eta, length + 1
        bright = dr.max(through)
        survives, risked = dr.minimum(bright * eta**2, MOST_SURVIVE), length > start
        through = dr.select(risked, through * dr.rcp(survives), through)
        onwards &= (~risked | (sampler.next_1d() < survives)) & (bright != 0)
        return (onwards, si.spawn_ray(si.to_world(sample.wo)), through, eta, length, sampler.drawn, dr.detach(si),
                sample.pdf, mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta), lobes, fresh, real)  # fmt: skip

    begin = (mi.Bool(True), ray, weight, mi.Float(1), mi.UInt32(1), sampler.drawn,
             dr.zeros(mi.SurfaceInteraction3f), mi.Float(1), mi.Bool(True), mi.UInt32(0), mi.Bool(False),
             mi.Bool(scene.environment() is not None))  # fmt: skip
    *_, real = dr.while_loop(begin, lambda active, *rest: active, bounce)
    dr.eval(account, chain, real)
    # Mitsuba drops the light of a path that has passed through everything it met and left a scene without a sky.
    counts = np.array(real)
    booked = (np.array(account).reshape(longest, 3, lanes) * counts).reshape(longest, 3, count, 2, spp // 2)
    passed = float(np.array(chain, dtype=np.float64)[counts].sum())
    return booked.mean(-1, dtype=np.float64).transpose(0, 3, 2, 1), passed


def _rays(mi: Any, sensors: list[Any], sampler: Any, pixel: Any, view: Any) -> tuple[Any, Any]:
    """The rays of the camera that each lane belongs to, and their weights; all cameras draw the same numbers."""
    import drjit as dr

    begun, ray, weight = sampler.drawn, dr.zeros(mi.Ray3f), dr.zeros(mi.Color3f)
    for k, sensor in enumerate(sensors):
        sampler.drawn = begun
        own, part = camera_rays(mi, sensor, sampler, pixel)
        ray = dr.select(view == k, mi.Ray3f(own), ray)
        weight = dr.select(view == k, mi.Color3f(part), weight)
    return ray, weight
