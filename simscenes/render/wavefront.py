"""Samples where they are needed: any number of them in each pixel of one view, in a JIT variant.

`mi.render` gives every pixel the same number. Here each pixel continues its own sequence by as many as are asked for,
and the samples are added up outside Mitsuba's film, in float64 and in a fixed order, so that the same seed gives the
same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.render.sampler import sampler_class

MAX_WAVEFRONT = 1 << 22  # samples traced at once; bounds the memory to some 200 MB
FOOTPRINT = 1 / 8  # of a pixel: neighbouring samples, not pixels, bound the area of a texture lookup


def from_numpy(kind: Any, values: NDArray[Any]) -> Any:
    """A JIT array of NumPy's values [n], in memory that starts at a multiple of 64 bytes.

    Dr.Jit reads NumPy's own memory, and whether that is aligned, which is chance, is compiled into the kernel: some
    kernels would be compiled twice, at a second each.
    """
    room = np.empty(values.nbytes + 64, dtype=np.uint8)
    start = -room.ctypes.data % 64
    aligned = room[start : start + values.nbytes].view(values.dtype)
    aligned[:] = values
    return kind(aligned)


@contextmanager
def compilation() -> Iterator[Callable[[], float]]:
    """Record kernels; yields a function that returns how many seconds their compilation has taken since."""
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        yield lambda: sum(kernel.get("backend_time", 0.0) for kernel in dr.kernel_history()) / 1000  # from ms


def sample_sums(
    mi: Any,
    scene: Any,
    sensor: Any,
    integrator: Any,
    first: NDArray[np.int64],
    more: NDArray[np.int64],
    seeds: Sequence[int],
    part: float = 1.0,
) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Sums over samples `first` .. `first + more - 1` of the sequences of every pixel, part by part of the picture.

    All sequences of a part are traced at once: a launch takes longer than the samples of a small picture.

    Args:
        mi: The mitsuba module, in a JIT variant.
        scene: The Mitsuba scene.
        sensor: With a box filter.
        integrator: A sampling integrator.
        first: Samples that each pixel had before in each of its sequences, row by row, [h*w].
        more: Samples to draw in each pixel and sequence, [h*w].
        seeds: One for each sequence that a pixel has, shared by all pixels; 32 bits.
        part: Of the width of a pixel, its middle, where samples fall.

    Yields:
        Which pixels, and [seeds, their number, 3] of the film's channels, summed over the samples.
    """
    ends, start = len(seeds) * np.cumsum(more), 0
    while start < len(more):
        drawn = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, drawn + MAX_WAVEFRONT, side="right")))
        here = slice(start, stop)
        yield here, _trace(mi, scene, sensor, integrator, start, first[here], more[here], seeds, part)
        start = stop


def _trace(
    mi: Any,
    scene: Any,
    sensor: Any,
    integrator: Any,
    start: int,
    first: NDArray[np.int64],
    more: NDArray[np.int64],
    seeds: Sequence[int],
    part: float,
) -> NDArray[np.float64]:
    import drjit as dr

    pixels, first, more = len(more), np.tile(first, len(seeds)), np.tile(more, len(seeds))
    sums, begins = np.zeros((len(more), 3)), np.cumsum(more) - more
    if not more.any():
        return sums.reshape(len(seeds), pixels, 3)
    film, count = sensor.film(), int(more.sum())
    entry = from_numpy(mi.UInt32, np.repeat(np.arange(len(more), dtype=np.uint32), more))
    # Number in the sequence minus number of the lane: it may wrap around below zero, and their sum then wraps back.
    offset = dr.gather(mi.UInt32, mi.UInt32((first - begins).astype(np.uint32)), entry)
    sequence = entry // dr.opaque(mi.UInt32, pixels)
    pixel = entry - sequence * dr.opaque(mi.UInt32, pixels) + dr.opaque(mi.UInt32, start)
    seed = dr.gather(mi.UInt32, mi.UInt32(np.array(seeds, dtype=np.uint32)), sequence)
    sampler = sampler_class(mi, mi.variant())(pixel, dr.arange(mi.UInt32, count) + offset, seed)
    ray, weight = camera_rays(mi, sensor, sampler, pixel, part)
    spectrum, _, _ = integrator.sample(scene, sampler, ray, sensor.get_medium(), mi.Bool(True))
    channels = _channels(mi, film, weight * spectrum, ray.wavelengths)
    dr.eval(channels)
    some = more > 0
    for k, channel in enumerate(channels):
        sums[some, k] = np.add.reduceat(np.array(channel, dtype=np.float64), begins[some])
    return sums.reshape(len(seeds), pixels, 3)


def camera_rays(mi: Any, sensor: Any, sampler: Any, pixel: Any, part: float = 1.0) -> tuple[Any, Any]:
    """A ray through a random place in each pixel, and its weight; the sampler's next numbers belong to the path."""
    import drjit as dr

    width, height = (int(n) for n in sensor.film().crop_size())
    row = pixel // dr.opaque(mi.UInt32, width)
    corner = mi.Vector2f(mi.Float(pixel - row * width), mi.Float(row))
    inside = 0.5 + dr.opaque(mi.Float, part) * (sampler.next_2d() - 0.5)
    place = (corner + inside) / mi.Vector2f(width, height)
    lens = sampler.next_lens() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
    wavelength = sampler.next_1d() if mi.is_spectral else mi.Float(0)
    ray, weight = sensor.sample_ray_differential(0.0, wavelength, place, lens)
    ray.scale_differential(FOOTPRINT * part)
    sampler.begin_path()
    return ray, weight


def _channels(mi: Any, film: Any, spectrum: Any, wavelengths: Any) -> list[Any]:
    """The film's values for each sample."""
    if mi.is_polarized:
        spectrum = mi.unpolarized_spectrum(spectrum)
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        # A film that no mi.render has prepared writes before the start of its buffer: the process aborts.
        film.prepare([])
        # Weight and alpha follow; without room for them Mitsuba writes past the end.
        room = film.base_channels_count() + 2
        return list(film.prepare_sample(spectrum, wavelengths, room))[:3]
    return list(mi.spectrum_to_srgb(spectrum, wavelengths) if mi.is_spectral else spectrum)
