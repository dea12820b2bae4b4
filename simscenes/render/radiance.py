"""Radiance of one view: with equally many samples everywhere, or as many as each pixel needs for a target error."""

from __future__ import annotations

import hashlib
import math
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.camera import camera_color
from simscenes.loading.load import LoadedScene
from simscenes.optics import Optics
from simscenes.render.motion import subframe_rig
from simscenes.render.sensors import PINHOLE, sensor_dict
from simscenes.render.sequences import Radiance, Sequences, sample_shares
from simscenes.render.wavefront import MAX_WAVEFRONT, compilation, sample_sums
from simscenes.rigs import Rig

Tick = Callable[[float], None]
PILOT_SPP = 32
MAX_SPP = 65536  # where target_error gives up
FIRST = 0.8  # of the samples that a pilot predicts: stratified ones leave less noise, the more there are
PILOT_PART = 0.25  # of these samples are spread evenly: with an eighth the shares are so noisy that they save less
MARGIN = 0.5  # standard errors of an estimated variance, for stopping at it
MAX_FILM_SPP = 1024  # of a film in float32: relative bias 1e-6 there, 1e-4 at 65k samples


@dataclass(frozen=True)
class RenderMethod:
    """How to render a view: everything but the view itself and how long."""

    mi: Any
    variant: str
    loaded: LoadedScene
    integrator: Any
    optics: Optics = PINHOLE
    subframes: int = 1
    seed: int = 0


def view_seed(rig: Rig, i: int, seed: int, *numbers: int) -> int:
    """Seed of one part of a view: a hash of the camera itself, so that the order of the views changes no pixel."""
    camera = rig.viewmats[i].tobytes() + rig.Ks[i].tobytes()
    digest = hashlib.sha256(camera + f"{rig.width}x{rig.height}:{seed}:{numbers}".encode()).digest()
    return int.from_bytes(digest[:4], "little")


@dataclass(frozen=True)
class FirstSamples:
    """The first samples of a view towards a target.

    Attributes:
        error: Relative error that one sample per pixel would have, spread as it should be.
        seconds: That one sample in every pixel took, without compiling the kernel.
    """

    error: float
    seconds: float


class RenderedView:
    """One view, to be rendered once."""

    def __init__(self, method: RenderMethod, rig: Rig, i: int) -> None:
        self.method, self.rig, self.i = method, rig, i
        frames = rig if method.subframes == 1 else subframe_rig(rig, i, method.optics.motion or 0.0, method.subframes)
        views = [i] if method.subframes == 1 else range(len(frames))
        self._poses = [(frames, k) for k in views]
        self.samples = Sequences((rig.height, rig.width), whole=len(self._poses))

    @cached_property
    def sensors(self) -> list[Any]:
        """Mitsuba sensors, one per sub-frame; made when the view's turn comes, in the method's variant."""
        m = self.method
        return [m.mi.load_dict(sensor_dict(m.mi, frames, k, m.loaded, m.optics)) for frames, k in self._poses]

    @property
    def scalar(self) -> bool:
        """Whether the variant has no wavefronts: it renders whole pictures, each stratified in itself."""
        return self.method.variant.startswith("scalar")

    def render(
        self, spp: int | None, target_error: float | None, tick: Tick = lambda part: None, least: int = 0
    ) -> Radiance:
        """Render with `spp` samples in every pixel, or until the relative RMSE of the view is `target_error`, and not
        before every pixel has `least`.

        The error seen is the difference between two independent halves of the samples: noise only. It cannot see light
        that both lack, such as light beyond the maximal path depth, or a caustic that neither has found yet.

        Towards a target, samples go where the first of them saw noise (see `simscenes.render.sequences`).

        `tick` is called now and then with the fraction of the work that is done.

        Raises:
            ValueError: If a pixel is nan, infinite or negative: the scene has an impossible emitter or reflectance.
        """
        if target_error is None:
            self._draw(self.samples.even(spp or 2), tick)
            return self.samples.result()
        s, wanted = self.samples, FIRST * self.predict_spp(target_error)
        self._draw(s.lacking(PILOT_PART * wanted, self._even), lambda part: tick(PILOT_PART * part))
        self._draw(s.even(least))
        shares, each = self._foreseen()
        wanted = min(FIRST * (each / target_error) ** 2, MAX_SPP)
        while s.error(margin=MARGIN) > target_error:
            before = min(s.spp / wanted, 1.0)
            self._draw(s.lacking(wanted, shares), lambda part, done=before: tick(done + part * (1 - done)))  # type: ignore[misc]
            if wanted >= MAX_SPP:
                break
            # One estimate alone may at most double the samples; less than a twentieth more is not worth a round.
            wanted = min(wanted * min(max((s.error(margin=MARGIN) / target_error) ** 2, 1.05), 2), MAX_SPP)
        if (error := s.error(margin=MARGIN)) > target_error:
            warnings.warn(
                f"view {self.i} stopped at a relative error of {error:.3g} after {s.spp:.0f} samples per pixel, before "
                f"the target of {target_error:g}", stacklevel=2,
            )  # fmt: skip
        return s.result()

    def spread(self, spp: float) -> None:
        """Draw `spp` samples per pixel on average, most of them where the first saw noise."""
        self._draw(self.samples.lacking(PILOT_PART * spp, self._even))
        shares, _ = self._foreseen()
        self._draw(self.samples.lacking(spp, shares))

    def _foreseen(self) -> tuple[NDArray[np.float64], float]:
        """How the next samples should be spread, [h,w], and the relative error of one per pixel, if they all were so.

        Even samples must have been drawn, and no others.
        """
        s = self.samples
        variance = s.variance().mean(-1) * s.spp
        shares = self._even if self.scalar else sample_shares(variance)
        level = float(s.mean().mean())
        return shares, math.sqrt((variance / shares).mean()) / level if level > 0 else 0.0

    @property
    def _even(self) -> NDArray[np.float64]:
        return np.ones(self.samples.count.shape)

    def _draw(self, more: NDArray[np.int64], tick: Tick = lambda part: None) -> None:
        """Add `more` samples [h,w] to each sequence; a scalar variant may add a few more than that everywhere."""
        s, frames = self.samples, len(self.sensors)
        first, each = (count.ravel() // frames for count in (s.count, more))
        if self.scalar:
            each = np.full_like(each, grid_spp(int(each.max())))
        sums = s.sums.reshape(2, -1, 3)
        for k, sensor in enumerate(self.sensors):
            for halves, part, light in self._light(sensor, first, each, k):
                sums[halves, part] += self._in_camera_rgb(light)
                tick((k + halves.stop / 2 * part.stop / each.size) / frames)
        s.count += frames * each.reshape(s.count.shape)
        self._checked(s.mean())

    def _light(
        self, sensor: Any, first: NDArray[np.int64], more: NDArray[np.int64], frame: int
    ) -> Iterator[tuple[slice, slice, NDArray[np.float64]]]:
        """Sums over `more` samples [h*w] of each pixel and sequence, after the `first` ones, part by part.

        Yields:
            Which sequences, which pixels, and the sums [sequences, pixels, 3].
        """
        m, both = self.method, slice(0, 2)
        if not self.scalar:
            seeds = [view_seed(self.rig, self.i, m.seed, half, frame) for half in range(2)]
            for part, sums in sample_sums(m.mi, m.loaded.scene, sensor, m.integrator, first, more, seeds):
                yield both, part, sums
            return
        for half in range(2):
            start, left = int(first[0]), int(more[0])
            while left > 0:
                spp = left if left <= MAX_FILM_SPP else MAX_FILM_SPP
                seed = view_seed(self.rig, self.i, m.seed, half, frame, start)
                film = m.mi.render(m.loaded.scene, sensor=sensor, integrator=m.integrator, spp=spp, seed=seed)
                light = spp * np.array(film, dtype=np.float64)[..., :3].reshape(1, -1, 3)
                yield slice(half, half + 1), slice(0, len(more)), light
                start, left = start + spp, left - spp

    def seconds(self, spp: int, part: float) -> float:
        """Seconds that rendering with `spp` samples takes, from about `part` of them, timed when the kernel is there.

        The part is a share of the pixels; in a scalar variant, of the samples. A quarter of it is timed as well, so
        that the time of a launch is not taken for the time of its samples: a few samples would seem up to half as slow
        again as many. This view cannot be rendered afterwards.
        """
        more = self.samples.even(spp)
        many, few = (self._share_of(more, share) for share in (min(part, 1.0), min(part, 1.0) / 4))
        self._draw(many)  # compiles
        spent = []
        for drawn in (many, few):
            start = time.perf_counter()
            self._draw(drawn)
            spent.append(time.perf_counter() - start)
        sizes = [self._cost_of(drawn) for drawn in (many, few)]
        return whole_seconds(spent, sizes, self._cost_of(more))

    def _share_of(self, more: NDArray[np.int64], part: float) -> NDArray[np.int64]:
        if self.scalar:
            return self.samples.even(part * 2 * float(more.max()))
        chosen = np.arange(more.size) % max(int(1 / part), 1) == 0
        return np.asarray(more * chosen.reshape(more.shape))

    def _cost_of(self, drawn: NDArray[np.int64]) -> tuple[int, int]:
        """Launches and samples that adding these takes."""
        samples, poses = 2 * int(drawn.sum()), len(self.sensors)
        return poses * math.ceil(samples / poses / MAX_WAVEFRONT), samples

    def _in_camera_rgb(self, light: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.method.optics.camera is None:
            return light
        camera = camera_color(self.method.optics.camera)
        if "spectral" in self.method.variant:
            return light / camera.green_integral
        # The matrix can give negative values where filters cannot. They stay until all samples are in: to clip noise
        # on its way would brighten it.
        return np.asarray(light @ camera.matrix.T)

    def _checked(self, image: NDArray[np.float64]) -> NDArray[np.float64]:
        # Spectral light may lie outside the triangle of sRGB, where a channel is negative; so may a camera's matrix.
        signed = "spectral" in self.method.variant or self.method.optics.camera is not None
        return check_radiance(image, self.i, signed=signed)

    @cached_property
    def pilot(self) -> FirstSamples:
        """The forecast of the first samples of a view towards a target for the others; they count among them."""
        s, start = self.samples, time.perf_counter()
        with compilation() as seconds:  # these samples are kept, and not drawn a second time to time them
            self._draw(s.even(PILOT_SPP))
            spent = time.perf_counter() - start - seconds()
        return FirstSamples(self._foreseen()[1], spent / s.spp)

    def predict_spp(self, target_error: float) -> int:
        """Samples per pixel that bring a pilot's error down to the target, if it falls as 1/sqrt(spp)."""
        wanted = (self.pilot.error / target_error) ** 2
        return min(max(PILOT_SPP, math.ceil(wanted)), MAX_SPP)


def whole_seconds(seconds: Sequence[float], parts: Sequence[tuple[int, int]], whole: tuple[int, int]) -> float:
    """Seconds of a job from the seconds of two parts of it, the larger first, all known by launches and samples.

    A launch takes time beside the time of its samples. This time lies between nothing and all of the smaller part,
    whatever noise of the clock says.
    """
    (spent, less), ((launches, samples), (fewer, sparse)) = seconds, parts
    # Where both parts are many launches, they say the same, and the launch cannot be told from its samples.
    apart = fewer * samples - launches * sparse
    launch = min(max((less * samples - spent * sparse) / apart, 0.0), less / fewer) if apart > 0 else 0.0
    return launch * whole[0] + max(spent - launch * launches, 0.0) / samples * whole[1]


def grid_spp(spp: float) -> int:
    """The smallest number of samples from `spp` up that `multijitter` can stratify: a grid of k x k, k + 1 or k + 2."""
    wanted = max(math.ceil(spp), 1)
    k = math.isqrt(wanted)
    return next(n for n in (k * k, k * (k + 1), k * (k + 2), (k + 1) ** 2) if n >= wanted)


def check_radiance(image: NDArray[np.float64], i: int, *, signed: bool = False) -> NDArray[np.float64]:
    """Return the image, or raise ValueError if a pixel is nan, infinite or (unless `signed`) negative."""
    bad = ~(np.isfinite(image) & (signed | (image >= 0)))
    if bad.any():
        y, x, c = (int(k) for k in np.argwhere(bad)[0])
        raise ValueError(
            f"radiance must be finite and >= 0, got {image[y, x, c]} at pixel ({x}, {y}) of view {i} "
            f"({bad.any(-1).sum()} of {bad[..., 0].size} pixels); look for a nan or negative emitter or reflectance"
        )
    return image
