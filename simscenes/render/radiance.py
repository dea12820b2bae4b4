"""Radiance of one view: with equally many samples everywhere, or as many as each pixel needs for a target error."""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.camera import camera_color
from simscenes.loading.load import LoadedScene
from simscenes.optics import Optics
from simscenes.render.motion import subframe_rig
from simscenes.render.passes import Passes, Radiance, pass_spp, sample_shares, split_passes
from simscenes.render.sensors import PILOT_SPP, PINHOLE, sensor_dict
from simscenes.render.wavefront import sample_blocks
from simscenes.rigs import Rig

Tick = Callable[[float], None]
MAX_SPP = 65536  # where target_error gives up
PLANNED_PASSES = 6  # towards a target error, each with an equal part of the predicted samples
MAX_BLOCKS = 1 << 20  # of several passes held at once; a single pass of a large image may exceed it
FEWEST_PASSES = 4  # with fewer, their spread cannot show whether the target is reached


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
        mi, each = self.method.mi, pass_spp(size / len(self._poses))
        for _ in range(count):
            image = np.zeros((self.rig.height, self.rig.width, 3))
            for sensor in self.sensors:
                film = mi.render(
                    self.method.loaded.scene, sensor=sensor, integrator=self.method.integrator, spp=each,
                    seed=self._next_seed(),
                )  # fmt: skip
                image += np.array(film, dtype=np.float64)[..., :3] / len(self._poses)
            passes.add(self._in_camera_rgb(image))

    def run_uneven(self, passes: Passes, count: int, blocks: NDArray[np.int64], size: int) -> None:
        """Add `count` passes with `blocks` [h,w] times `size` samples in each pixel, small ones traced together."""
        owner = np.repeat(np.arange(blocks.size), blocks.ravel())
        together = max(1, MAX_BLOCKS // len(owner))
        for first in range(0, count, together):
            number = min(together, count - first)
            slots = (np.arange(number)[:, None] * blocks.size + owner).ravel()
            sums = np.zeros((number * blocks.size, 3))
            for part, means in self._blocks(slots % blocks.size, size):
                sums += np.stack([np.bincount(slots[part], m, len(sums)) for m in means.T], axis=-1)
            for image in sums.reshape(number, *blocks.shape, 3):
                passes.add(self._in_camera_rgb(image / blocks[..., None]))

    def _blocks(self, pixels: NDArray[np.intp], size: int) -> Iterator[tuple[slice, NDArray[np.float64]]]:
        m = self.method
        return sample_blocks(m.mi, m.loaded.scene, self.sensors[0], m.integrator, pixels, size, self._next_seed())

    def _in_camera_rgb(self, image: NDArray[np.float64]) -> NDArray[np.float64]:
        spectral = "spectral" in self.method.variant
        if self.method.optics.camera is None:
            # Spectral light may lie outside the triangle of sRGB, where a channel is negative.
            return check_radiance(image, self.i, signed=spectral)
        camera = camera_color(self.method.optics.camera)
        check_radiance(image, self.i)
        if spectral:
            return image / camera.green_integral
        return np.clip(image @ camera.matrix.T, 0, None)  # the matrix can give negative values, filters cannot

    def render(self, spp: int | None, target_error: float | None, tick: Tick = lambda part: None) -> Radiance:
        """Render with `spp` samples in every pixel, or until the relative RMSE of the view is `target_error`.

        The error seen is the spread between independent passes: noise only. It cannot see what every pass lacks, such
        as light beyond the maximal path depth, or a caustic that no pass has found yet.

        Towards a target, samples go where a short pilot saw noise. The pilot itself is thrown away: an average that
        kept it would be biased, since it decided how much each pixel's other samples count.

        `tick` is called after every pass with the fraction of the work that is done.

        Raises:
            ValueError: If a pixel is nan, infinite or negative: the scene has an impossible emitter or reflectance.
        """
        if target_error is not None:
            return self._render_to(target_error, tick)
        count, size = split_passes(spp or 2)
        size = max(size, len(self._poses))  # both powers of four: each sub-frame gets its whole share
        passes = Passes((self.rig.height, self.rig.width))
        for done in range(count):
            self.run(passes, 1, size)
            tick((done + 1) / count)
        return passes.result(size)

    def _render_to(self, target_error: float, tick: Tick) -> Radiance:
        each = self.predict_spp(target_error) / PLANNED_PASSES
        passes = Passes((self.rig.height, self.rig.width))
        if self.even:
            size = spp = max(pass_spp(each), len(self._poses))
        else:
            size = (
                64 if each >= 256 else PILOT_SPP
            )  # larger blocks are stratified better, smaller ones are spread finer
            blocks = np.maximum(np.rint(self.pilot[1] * each / size), 1).astype(np.int64)
            spp = size * blocks.mean()
        count = FEWEST_PASSES
        while passes.count == 0 or (passes.error() > target_error and passes.count * spp < MAX_SPP):
            if self.even:
                self.run(passes, count, size)
            else:
                self.run_uneven(passes, count, blocks, size)
            # The error falls with the square root of the samples; one estimate alone may at most double them.
            lacking = passes.count * ((passes.error() / target_error) ** 2 - 1)
            count = min(max(math.ceil(lacking), 1), passes.count)
            tick(passes.count / max(passes.count + lacking, passes.count))
        if (reached := passes.error()) > target_error:
            warnings.warn(
                f"view {self.i} stopped at a relative error of {reached:.3g} after {MAX_SPP} samples per pixel, before "
                f"the target of {target_error:g}", stacklevel=2,
            )  # fmt: skip
        return passes.result(spp)

    @property
    def even(self) -> bool:
        """Whether all pixels get as many samples: scalar variants have no wavefronts, moving cameras sub-frames."""
        return self.method.variant.startswith("scalar") or len(self._poses) > 1

    @cached_property
    def pilot(self) -> tuple[float, NDArray[np.float64]]:
        """Relative error with one sample per pixel, and the share of the samples each pixel should get, mean 1."""
        pilot = Passes((self.rig.height, self.rig.width))
        size = max(PILOT_SPP, len(self._poses))
        if self.even:
            self.run(pilot, 2, size)
        else:
            self.run_uneven(pilot, 2, np.ones((self.rig.height, self.rig.width), np.int64), size)
        seen = pilot.result(size)
        variance = seen.variance.astype(np.float64).mean(-1) * seen.spp
        shares = np.ones_like(variance) if self.even else sample_shares(variance)
        level = float(seen.mean.mean())
        return (math.sqrt((variance / shares).mean()) / level if level > 0 else 0.0), shares

    def predict_spp(self, target_error: float) -> int:
        """Samples per pixel that bring a pilot's error down to the target, if it falls as 1/sqrt(spp)."""
        wanted = (self.pilot[0] / target_error) ** 2
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
