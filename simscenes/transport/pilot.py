"""Cheap renders that measure how much each effect contributes.

All pilots of a plan share views and random numbers, so that their differences are differences of transport: the same
paths, cut at another depth, followed through fog or past it, with or without polarisation.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.backend import COLORS, using_variant
from simscenes.loading.contents import media_in, unique_materials
from simscenes.loading.load import LoadedScene, build_scene
from simscenes.loading.reference import SceneRef
from simscenes.render.radiance import view_seed
from simscenes.render.sensors import sensor_dict
from simscenes.render.sequences import mean_at_most
from simscenes.rigs import Rig
from simscenes.transport.lengths import Lengths, light_by_length

N_VIEWS = 3
MOST = 0.99  # of the light that anything reflects; without a limit below 1 a closed room has no bound
SIZE = 32  # pixels along the longer side
SPP = 64  # of pilots
PER_PIXEL = 4  # pilot samples per pixel of the job, at most: planning a short job must not outlast it
FEWEST_SPP = 16  # of pilots, however short the job
CUT_SPP = 256  # of pilots for a depth that was decided by hand: what it cuts may be most of the error that is stated
RR_DEPTH = 2  # where Russian roulette starts in pilots
DEEPEST = 64  # pilot paths end here, where that is deep enough


@dataclass(frozen=True)
class Pilot:
    """The basis of all decisions."""

    mi: Any
    source: SceneRef
    loaded: LoadedScene  # in `base` colours
    rig: Rig
    backend: str
    allowed: float
    seed: int
    allow_outside: bool = False
    hide_emitters: bool = False
    base: str = "rgb"  # the fewest colours that the scene can be loaded in
    spp: int = SPP
    scenes: dict[str, LoadedScene] = field(default_factory=dict)
    images: dict[tuple[str, int, int], NDArray[np.float64]] = field(default_factory=dict)
    by_length: dict[int, Lengths] = field(default_factory=dict)
    rms: dict[str, tuple[float, ...]] = field(default_factory=dict)  # effect -> `Share.rms` of leaving it out

    def render(self, kind: str, depth: int, rr_depth: int = RR_DEPTH) -> NDArray[np.float64]:
        """The pilot views [2,c,h,w,3], by the same paths for all depths; rendered once.

        In scalar variants the paths differ, since their samplers continue from one to the next: differences are noisier
        there, and bounds wider.
        """
        key = (kind, depth, rr_depth)
        if key not in self.images:
            integrator = {"type": kind, "max_depth": depth, "rr_depth": rr_depth, **self.hiding}
            self.images[key] = render_pilot(self.mi, self.loaded, self.rig, integrator, self.seed, self.spp)
        return self.images[key]

    def cut(self, kind: str, depth: int, deepest: int) -> NDArray[np.float64]:
        """The pilot views [2,c,h,w,3] by paths up to `depth`, where the longest end at `deepest`.

        From one pass over all lengths where there is such a pass, else from a render of each depth. The deeper ones do
        without roulette: it ends one path in twenty at every bounce, however bright, so that few of hundreds of bounces
        would be found.
        """
        if kind == "path" and self.backend != "scalar" and self.base == "rgb" and not self.hide_emitters:
            return np.asarray(self.lengths(deepest).light[:depth].sum(0))
        return self.render(kind, depth, _roulette_until(deepest))

    def lengths(self, deepest: int) -> Lengths:
        """The light that paths over surfaces find, by their length; followed once. In an RGB JIT variant."""
        if deepest not in self.by_length:
            start = _roulette_until(deepest)
            found = light_by_length(self.mi, self.loaded, self.rig, deepest, start, self.spp, self.seed)
            check_finite(found.light, self.loaded.name)
            self.by_length[deepest] = found
        return self.by_length[deepest]

    @property
    def hiding(self) -> dict[str, bool]:
        """Settings of an integrator, besides its depths, in this scene: cameras may look through lamps."""
        return {"hide_emitters": True} if self.hide_emitters else {}

    @property
    def colors(self) -> tuple[str, ...]:
        """The colour representations that the scene can be loaded in: objects made in Python belong to one.

        So do raw bitmaps that are used as colours.
        """
        first = COLORS.index(self.base)
        one = self.loaded.rgb_alone or _holds_objects(self.mi, self.source.description)
        return COLORS[first : first + 1] if one else COLORS[first:]

    def loads(self, color: str) -> bool:
        """Whether the scene can be loaded in a colour representation; tried, since plugins may be missing there."""
        if color not in self.colors:
            return False
        try:
            with self.in_color(color):
                return True
        except ValueError:
            return False

    @contextmanager
    def in_color(self, color: str) -> Iterator[tuple[Any, LoadedScene]]:
        """Mitsuba in the variant of a colour representation, and the scene loaded for it."""
        with using_variant(self.backend, color) as mi:
            if color != self.base and color not in self.scenes:
                self.scenes[color] = build_scene(self.source, mi, allow_outside=self.allow_outside)
            yield mi, self.loaded if color == self.base else self.scenes[color]


def _roulette_until(deepest: int) -> int:
    """Where roulette starts in pilots that end at `deepest`; beyond it in the deeper ones."""
    return RR_DEPTH if deepest <= DEEPEST else deepest + 1


def _holds_objects(mi: Any, node: Any) -> bool:
    return isinstance(node, mi.Object) or (isinstance(node, dict) and any(_holds_objects(mi, v) for v in node.values()))


def pilot_rig(rig: Rig) -> Rig:
    """A few small views spread over a rig, with its fields of view; the same ones for any order of the rig."""
    cameras = np.hstack([rig.viewmats.reshape(len(rig), -1), rig.Ks.reshape(len(rig), -1)])
    order = np.lexsort(cameras.T[::-1])
    chosen = order[np.unique(np.linspace(0, len(rig) - 1, N_VIEWS).round().astype(int))]
    scale = SIZE / max(rig.width, rig.height)
    width, height = (max(1, round(n * scale)) for n in (rig.width, rig.height))
    stretch = np.diag([width / rig.width, width / rig.width, 1.0])
    Ks = stretch @ rig.Ks[chosen]
    Ks[:, 1, 2] = rig.Ks[chosen, 1, 2] * height / rig.height
    return Rig(viewmats=rig.viewmats[chosen], Ks=Ks, width=width, height=height)


def pilot_spp(rig: Rig, small: Rig) -> int:
    """Samples per pixel of the pilot views `small` of a rig: a power of two, since Sobol points are even then."""
    share = PER_PIXEL * len(rig) * rig.width * rig.height / (len(small) * small.width * small.height)
    return int(np.clip(1 << int(np.log2(max(share, 1))), FEWEST_SPP, SPP))


def render_pilot(
    mi: Any, loaded: LoadedScene, rig: Rig, integrator: dict[str, Any], seed: int, spp: int = SPP
) -> NDArray[np.float64]:
    """Radiance of all pilot views, [2,c,h,w,3], by two independent halves of the samples; the same `seed` follows the
    same paths.
    """
    method = mi.load_dict(integrator)
    halves = []
    for half in range(2):
        for i in range(len(rig)):
            sensor, number = mi.load_dict(sensor_dict(mi, rig, i, loaded)), view_seed(rig, i, seed, half)
            image = mi.render(loaded.scene, sensor=sensor, integrator=method, spp=spp // 2, seed=number)
            halves.append(np.array(image, dtype=np.float64)[..., :3])
    result = np.stack(halves).reshape(2, len(rig), *halves[0].shape)
    check_finite(result, loaded.name)
    return result


def check_finite(radiance: NDArray[np.float64], name: str) -> None:
    """Refuse a scene whose pilots hold nan or infinity, with ValueError."""
    if not np.isfinite(radiance).all():
        raise ValueError(f"scene {name!r} renders to nan or infinite radiance; look for a broken emitter, or a "
                         "medium whose sigma_t is 0 at some wavelengths")  # fmt: skip


@dataclass(frozen=True)
class Share:
    """A part of the light, relative to all of it: its estimate, and an upper limit at three standard errors.

    `rms` is where it lies, `root_mean_squares`.
    """

    estimate: float
    upper: float
    rms: tuple[float, ...] = field(default=(), compare=False)


def missing_light(full: NDArray[np.float64], part: NDArray[np.float64]) -> Share:
    """Share of `full` that `part`, cut from the same paths, lacks; pixels are independent samples of it.

    Args:
        full: Pilot views, [2,c,h,w,3], by two independent halves of the samples.
        part: The same by a part of the paths.
    """
    total = float(full.mean())
    if total <= 0:
        return Share(0.0, 0.0)
    lacking = (full - part).mean((0, -1)).ravel()
    error = float(lacking.std(ddof=1) / np.sqrt(lacking.size)) if lacking.size > 1 else 0.0
    estimate = max(float(lacking.mean()), 0.0)
    return Share(estimate / total, (estimate + 3 * error) / total, root_mean_squares(full - part, full))


def root_mean_squares(change: NDArray[np.float64], full: NDArray[np.float64]) -> tuple[float, ...]:
    """An error of pixels, at most: root mean square of a change over the picture relative to the mean radiance, then
    within each quarter of the picture by brightness, darkest first, relative to the mean of that quarter.

    Both [2,c,h,w,3]. The product of two independent changes of a pixel has the mean of the square without noise, for
    every pixel and channel: no neighbourhood is averaged, in which light and shade would cancel. Three standard errors
    are added; the square is at least the square of the mean.
    """
    product, moved, light = (v.mean(-1).ravel() for v in (change[0] * change[1], change.mean(0), full.mean(0)))
    order = np.argsort(light, kind="stable")
    quarters = np.array_split(order, 4) if len(order) >= 4 else [order] * 4
    least = 1e-12 * max(light.max(), 1e-300)  # a quarter without light would divide by zero
    found = []
    for chosen in (order, *quarters):
        square = max(mean_at_most(product[chosen], 3), moved[chosen].mean() ** 2)
        found.append(math.sqrt(square) / max(light[chosen].mean(), least))
    return tuple(found)


def _block_numbers(image: NDArray[np.float64], block: int) -> NDArray[np.intp]:
    """Number of the block of pixels, from 0, that each pixel of views [c,h,w,3] lies in, flat."""
    c, h, w, _ = image.shape
    y, x = np.arange(h) // block, np.arange(w) // block
    label = (np.arange(c)[:, None, None] * (h * w) + (y[:, None] * w + x[None])).ravel()
    return np.unique(label, return_inverse=True)[1]


def beyond(cut: Share, later: Share, bounces: int, most: float) -> Share:
    """A cut's missing light, including light of paths `bounces` deeper and beyond, if each bounce keeps at most `most`.

    All light after those paths is at most `most ** bounces` of the light they found beyond the cut, and so on: a
    geometric series. The ratio of the last two bounces instead is known to come out a tenth to a fifth too low. Where
    the light lies is told more closely, by `later`, the limit of what those paths leave out.
    """
    rms = tuple(seen + left for seen, left in zip(cut.rms, later.rms, strict=True)) if cut.rms else ()
    return Share(cut.estimate, cut.upper / (1 - most**bounces), rms)


def most_reflected(mi: Any, loaded: LoadedScene) -> float:
    """The largest share of the light that a bounce keeps: the largest albedo of any surface, 0.99 where not known."""
    if media_in(loaded.scene, mi) or not mi.is_rgb:  # spectra are kept as coefficients of curves
        return MOST
    lobes, matt = int(mi.BSDFFlags.All), int(mi.BSDFFlags.DiffuseReflection)
    albedos = []
    for bsdf in (shape.bsdf() for shape in unique_materials(loaded.scene, mi)):
        params = mi.traverse(bsdf)
        names = [k for k in params.keys() if "reflectance" in k and k.endswith((".value", ".data"))]
        if bsdf.flags() & lobes & ~matt or not names:
            return MOST
        albedos += [float(np.array(params[k]).max()) for k in names]
    return min(max(albedos, default=MOST), MOST)


def seconds_per_sample(mi: Any, loaded: LoadedScene, rig: Rig, integrator: dict[str, Any], seed: int) -> float:
    """Processor seconds (on a GPU: seconds) that one sample of the middle pilot view takes once its kernel is compiled.

    Processor time, because two numbers are compared, and other processes must not disturb them.
    """
    clock = time.perf_counter if mi.variant().startswith("cuda") else time.process_time
    method, i = mi.load_dict(integrator), len(rig) // 2
    sensor = mi.load_dict(sensor_dict(mi, rig, i, loaded))
    seconds = []
    for spp in (1, SPP, SPP):
        start = clock()
        np.array(mi.render(loaded.scene, sensor=sensor, integrator=method, spp=spp, seed=view_seed(rig, i, seed, spp)))
        seconds.append(clock() - start)
    return min(seconds[1:]) / (SPP * rig.width * rig.height)


def changed_light(full: NDArray[np.float64], other: NDArray[np.float64], block: int = 4) -> Share:
    """Mean absolute change between two renders [2,c,h,w,3] relative to all light, over blocks of pixels; both may err
    by noise.

    Blocks average noise that differs between the two, which would otherwise count as change; the remaining noise
    counts, so the estimate errs upwards.
    """
    total = float(full.mean())
    if total <= 0:
        return Share(0.0, 0.0)
    label = _block_numbers(full[0], block)
    change = (other - full).mean((0, -1)).ravel()
    counts = np.bincount(label)
    blocks = np.abs(np.bincount(label, change) / counts)
    spread = float(np.abs(blocks).std() / np.sqrt(len(blocks)))
    estimate = float(np.average(blocks, weights=counts))
    return Share(estimate / total, (estimate + 3 * spread) / total, root_mean_squares(other - full, full))
