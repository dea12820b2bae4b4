"""Samples where they are needed: any number of them in each pixel of one view, in a JIT variant.

`mi.render` gives every pixel the same number. Here a pixel gets whole blocks of samples, each stratified in itself, and
the blocks are added up outside of Mitsuba's film, in float64 and in a fixed order, so that the same seed gives the same
bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_WAVEFRONT = 1 << 22  # samples traced at once; bounds the memory to some 200 MB


def sample_blocks(
    mi: Any, scene: Any, sensor: Any, integrator: Any, pixels: NDArray[np.integer[Any]], spp: int, seed: int
) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Mean of the film's channels over one stratified block of samples for each entry of `pixels`, part by part.

    Args:
        mi: The mitsuba module, in a JIT variant.
        scene: The Mitsuba scene.
        sensor: With a box filter, whose sampler stratifies.
        integrator: A sampling integrator.
        pixels: Pixel of each block, row by row, [n]; pixels may repeat.
        spp: Samples in a block, as many as the sampler can stratify.
        seed: Of all blocks together.

    Yields:
        Which entries of `pixels`, and [their number, 3] of what the film's channels would hold.
    """
    step = max(1, MAX_WAVEFRONT // spp)
    for k, first in enumerate(range(0, len(pixels), step)):
        part = slice(first, first + step)
        yield part, _trace(mi, scene, sensor, integrator, pixels[part], spp, seed + 0x9E3779B9 * k)


def _trace(
    mi: Any, scene: Any, sensor: Any, integrator: Any, pixels: NDArray[np.integer[Any]], spp: int, seed: int
) -> NDArray[np.float64]:
    import drjit as dr

    film, count = sensor.film(), len(pixels) * spp
    sampler = sensor.sampler().clone()
    sampler.set_sample_count(spp)
    assert sampler.sample_count() == spp, f"{spp} samples do not fit the sampler's grid"
    sampler.set_samples_per_wavefront(spp)
    sampler.seed(seed & 0xFFFFFFFF, count)
    block = dr.arange(mi.UInt32, count) // dr.opaque(mi.UInt32, spp)
    pixel = dr.gather(mi.UInt32, mi.UInt32(np.ascontiguousarray(pixels, dtype=np.uint32)), block)
    width, height = (int(n) for n in film.crop_size())
    row = pixel // dr.opaque(mi.UInt32, width)
    corner = mi.Vector2f(mi.Float(pixel - row * width), mi.Float(row))
    place = (corner + sampler.next_2d()) / mi.Vector2f(width, height)
    lens = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
    wavelength = sampler.next_1d() if mi.is_spectral else mi.Float(0)
    ray, weight = sensor.sample_ray_differential(0.0, wavelength, place, lens)
    ray.scale_differential(float(spp) ** -0.5)  # neighbouring samples, not pixels, bound what a texture lookup covers
    spectrum, _, _ = integrator.sample(scene, sampler, ray, sensor.get_medium(), mi.Bool(True))
    channels = _channels(mi, film, weight * spectrum, ray.wavelengths)
    dr.eval(channels)
    return np.stack([np.array(c, dtype=np.float64).reshape(len(pixels), spp).mean(1) for c in channels], axis=-1)


def _channels(mi: Any, film: Any, spectrum: Any, wavelengths: Any) -> list[Any]:
    """What the film would store for each sample."""
    if mi.is_polarized:
        spectrum = mi.unpolarized_spectrum(spectrum)
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        # A film that no mi.render has prepared writes before the start of its buffer: the process aborts.
        film.prepare([])
        # Weight and alpha follow; without room for them Mitsuba writes past the end.
        room = film.base_channels_count() + 2
        return list(film.prepare_sample(spectrum, wavelengths, room))[:3]
    return list(mi.spectrum_to_srgb(spectrum, wavelengths) if mi.is_spectral else spectrum)
