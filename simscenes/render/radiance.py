"""Radiance of one view: with equally many samples everywhere, or as many as each pixel needs for a target error."""

from __future__ import annotations

import hashlib
import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.camera import camera_color
from simscenes.loading.load import LoadedScene
from simscenes.optics import Optics
from simscenes.render.blocks import Blocks, sample_shares
from simscenes.render.motion import subframe_rig
from simscenes.render.passes import Passes, Radiance, grid_spp, pass_spp, relative_error, split_passes, summary
from simscenes.render.sensors import PILOT_SPP, PINHOLE, sensor_dict
from simscenes.render.wavefront import sample_blocks
from simscenes.rigs import Rig

Tick = Callable[[float], None]
MAX_SPP = 65536  # where target_error gives up
MAX_BLOCK_SPP = 1024
FEWEST_BLOCKS = 4  # of one size in a pixel on average: with larger blocks the shares of the pixels become coarse
WORTH = 4  # times its own samples, from where a pilot is thrown away for samples where the noise is
SEVERAL_SIZES = 1 << 23  # samples in a view, from where blocks of several sizes pay for their kernels (a second each)
FIRST = 0.9  # of the samples that a pilot predicts: larger blocks than its own are stratified better


@dataclass(frozen=True)
class Method:
    """How to render a view: everything but the view itself and how long."""

    mi: Any
    variant: str
    loaded: LoadedScene
    integrator: Any
    optics: Optics = PINHOLE
    subframes: int = 1
    seed: int = 0


def view_seed(rig: Rig, i: int, seed: int, number: int) -> int:
    """Seed of one pass: a hash of the camera itself, so that the order of the views changes no pixel."""
    camera = rig.viewmats[i].tobytes() + rig.Ks[i].tobytes()
    digest = hashlib.sha256(camera + f"{rig.width}x{rig.height}:{seed}:{number}".encode()).digest()
    return int.from_bytes(digest[:4], "little")


@dataclass(frozen=True)
class Pilot:
    """A few samples in every pixel of a view.

    Attributes:
        passes: Equal passes.
        spp: Samples per pixel in all of them.
        shares: Share of the samples that each pixel should get, mean 1, [h,w].
        error: Relative error that one sample per pixel, spread by `shares`, would have.
        seconds: That one sample in every pixel took, the kernel being compiled.
    """

    passes: Passes
    spp: int
    shares: NDArray[np.float64]
    error: float
    seconds: float


class View:
    """One view, ready to be rendered in passes."""

    def __init__(self, method: Method, rig: Rig, i: int) -> None:
        self.method, self.rig, self.i, self.number = method, rig, i, 0
        frames = rig if method.subframes == 1 else subframe_rig(rig, i, method.optics.motion or 0.0, method.subframes)
        views = [i] if method.subframes == 1 else range(len(frames))
        self._poses = [(frames, k) for k in views]

    @cached_property
    def sensors(self) -> list[Any]:
        """Mitsuba sensors, one per sub-frame; made when the view's turn comes, in the method's variant."""
        m = self.method
        return [m.mi.load_dict(sensor_dict(m.mi, frames, k, m.loaded, m.optics)) for frames, k in self._poses]

    def _next_seed(self) -> int:
        self.number += 1
        return view_seed(self.rig, self.i, self.method.seed, self.number - 1)

    def run(self, passes: Passes, count: int, size: int) -> None:
        """Add `count` passes of `size` samples per pixel, spread over the sub-frames (at least one in each)."""
        for _ in range(count):
            passes.add(self._checked(self._pixels(None, size).reshape(self.rig.height, self.rig.width, 3)))

    def run_blocks(self, blocks: Blocks, more: NDArray[np.int64]) -> None:
        """Add `more` [h,w] blocks to the pixels."""
        if self.even:
            for _ in range(int(more.max())):
                blocks.add(np.arange(more.size), self._pixels(None, int(blocks.size.flat[0])))
        else:
            for size in np.unique(blocks.size):
                pixels = np.repeat(np.arange(more.size), np.where(blocks.size == size, more, 0).ravel())
                blocks.add(pixels, self._pixels(pixels, int(size)))
        self._checked(blocks.mean())

    def _pixels(self, pixels: NDArray[np.intp] | None, size: int) -> NDArray[np.float64]:
        """Mean of `size` samples in each of these pixels, which may repeat, or in all: camera RGB [n,3]."""
        each = grid_spp(size / len(self._poses))
        total = sum(self._samples(sensor, pixels, each) for sensor in self.sensors)
        return self._in_camera_rgb(np.asarray(total) / len(self._poses))

    def seconds(self, size: int, part: float) -> float:
        """Seconds of a pass of `size`, from `part` of its pixels (or a few more), timed when the kernel is compiled."""
        count = self.rig.height * self.rig.width
        chosen = None if self.method.variant.startswith("scalar") else np.arange(0, count, max(int(1 / part), 1))
        for _ in range(2):
            start = time.perf_counter()
            self._pixels(chosen, size)
        return (time.perf_counter() - start) * (1 if chosen is None else count / len(chosen))

    def _samples(self, sensor: Any, pixels: NDArray[np.intp] | None, spp: int) -> NDArray[np.float64]:
        m, seed = self.method, self._next_seed()
        if m.variant.startswith("scalar"):
            assert pixels is None, "scalar variants render whole images"
            film = m.mi.render(m.loaded.scene, sensor=sensor, integrator=m.integrator, spp=spp, seed=seed)
            return np.array(film, dtype=np.float64)[..., :3].reshape(-1, 3)
        chosen = np.arange(self.rig.height * self.rig.width) if pixels is None else pixels
        parts = [means for _, means in sample_blocks(m.mi, m.loaded.scene, sensor, m.integrator, chosen, spp, seed)]
        return np.concatenate([np.empty((0, 3)), *parts])

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

    def render(self, spp: int | None, target_error: float | None, tick: Tick = lambda part: None) -> Radiance:
        """Render with `spp` samples in every pixel, or until the relative RMSE of the view is `target_error`.

        The error seen is the spread between independent passes or blocks: noise only. It cannot see what all of them
        lack, such as light beyond the maximal path depth, or a caustic that none has found yet.

        Towards a target, samples go where a short pilot saw noise, which is then thrown away (see
        `simscenes.render.blocks`); where few are needed, its samples count, and all pixels get as many.

        `tick` is called after every pass with the fraction of the work that is done.

        Raises:
            ValueError: If a pixel is nan, infinite or negative: the scene has an impossible emitter or reflectance.
        """
        if target_error is not None:
            return self._render_to(target_error, tick)
        count, size = self.passes(spp or 2)
        passes = Passes((self.rig.height, self.rig.width))
        for done in range(count):
            self.run(passes, 1, size)
            tick((done + 1) / count)
        return passes.result(size)

    def passes(self, spp: int) -> tuple[int, int]:
        """Number of passes and samples per pixel of each; every sub-frame gets equally many, and one at least."""
        count, size = split_passes(spp)
        return count, self._whole(size)

    def _whole(self, size: int) -> int:
        return len(self._poses) * grid_spp(size / len(self._poses))

    def _render_to(self, target_error: float, tick: Tick) -> Radiance:
        pilot, wanted = self.pilot, FIRST * self.predict_spp(target_error)
        even = self.even or wanted < WORTH * pilot.spp
        shares = np.ones_like(pilot.shares) if even else pilot.shares
        blocks = Blocks(pilot.passes, pilot.spp if even else 0, self._block_sizes(wanted, shares, even))
        error = pilot.passes.error()
        while error > target_error and wanted < MAX_SPP:
            self.run_blocks(blocks, blocks.lacking(wanted, shares))
            error = relative_error(blocks.mean(), blocks.variance())
            tick(min((target_error / error) ** 2, 1.0) if error > 0 else 1.0)
            # One estimate alone may at most double the samples; less than a twentieth more is not worth a round.
            wanted *= min(max((error / target_error) ** 2, 1.05), 2)
        self._gave_up(error, target_error)
        return summary(blocks.mean(), blocks.variance(), blocks.spp or pilot.spp)

    def _block_sizes(self, wanted: float, shares: NDArray[np.float64], even: bool) -> NDArray[np.int64]:
        """Samples in a block of each pixel: large ones are stratified better, but two must be there for a variance."""
        one = even or wanted * shares.size < SEVERAL_SIZES
        asked = np.full(shares.shape, wanted / FEWEST_BLOCKS) if one else wanted * shares / 2
        sizes = np.clip(pass_spp(asked), PILOT_SPP, MAX_BLOCK_SPP)
        return np.full_like(sizes, self._whole(int(sizes.flat[0]))) if even else sizes

    def _gave_up(self, reached: float, target_error: float) -> None:
        if reached > target_error:
            warnings.warn(
                f"view {self.i} stopped at a relative error of {reached:.3g} after {MAX_SPP} samples per pixel, before "
                f"the target of {target_error:g}", stacklevel=4,
            )  # fmt: skip

    @property
    def even(self) -> bool:
        """Whether all pixels get as many samples: scalar variants have no wavefronts, moving cameras sub-frames."""
        return self.method.variant.startswith("scalar") or len(self._poses) > 1

    @cached_property
    def pilot(self) -> Pilot:
        """The first samples of a view towards a target, and what they say about the others."""
        passes, (count, size) = Passes((self.rig.height, self.rig.width)), self.passes(2 * PILOT_SPP)
        for _ in range(count):
            start = time.perf_counter()
            self.run(passes, 1, size)
        seconds, spp = (time.perf_counter() - start) / size, count * size
        variance = passes.variance().mean(-1) * spp
        shares = np.ones_like(variance) if self.even else sample_shares(variance)
        level = float(passes.mean.mean())
        error = math.sqrt((variance / shares).mean()) / level if level > 0 else 0.0
        return Pilot(passes, spp, shares, error, seconds)

    def predict_spp(self, target_error: float) -> int:
        """Samples per pixel that bring a pilot's error down to the target, if it falls as 1/sqrt(spp)."""
        wanted = (self.pilot.error / target_error) ** 2
        return min(max(2 * PILOT_SPP, math.ceil(wanted)), MAX_SPP)


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
