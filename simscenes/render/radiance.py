"""Radiance of one view: independent passes of bounded length, averaged in float64, with their variance.

A pass stays at 1024 samples per pixel at most: Mitsuba's film adds up in float32, where a longer sum loses the small
contributions (relative bias 1e-4 at 65k samples, 1e-6 at 1k).
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.rigs import Rig, intrinsics_to_mitsuba, opencv_to_mitsuba

MAX_PASS_SPP = 1024
MAX_SPP = 65536  # where target_error gives up
PILOT_SPP = 16


@dataclass(frozen=True)
class Radiance:
    """What the passes of one view add up to.

    Attributes:
        mean: Radiance, float32 [h,w,3].
        variance: Estimated variance of `mean`, float32 [h,w,3]; unbiased, but from few passes, so noisy per pixel.
        spp: Samples per pixel behind `mean`.
        error: Relative RMSE: root of the mean variance over the mean radiance.
    """

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    spp: int
    error: float


def sensor_dict(mi: Any, rig: Rig, i: int, extent: float) -> dict[str, Any]:
    """Mitsuba sensor of view `i`: box filter (others leak between pixels and are not repeatable), float32 film.

    Args:
        mi: The mitsuba module.
        rig: The cameras.
        i: Which one.
        extent: Size of the scene, scene units; clip planes are set from it.
    """
    fov, ppx, ppy = intrinsics_to_mitsuba(rig.Ks[i], rig.width, rig.height)
    return {
        "type": "perspective",
        "fov": fov,
        "fov_axis": "x",
        "principal_point_offset_x": ppx,
        "principal_point_offset_y": ppy,
        "near_clip": 1e-4 * extent,
        "far_clip": 1e2 * extent,
        "to_world": mi.ScalarTransform4f(opencv_to_mitsuba(rig.viewmats[i])),
        "sampler": {"type": "multijitter", "sample_count": PILOT_SPP},
        "film": {
            "type": "hdrfilm",
            "width": rig.width,
            "height": rig.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
    }


def split_passes(spp: int) -> tuple[int, int]:
    """Number of passes (even, at least 2) and samples per pixel of each, together at least `spp`.

    A pass has n x m or n x (n+1) samples, as the multijittered sampler lays them out on a grid.
    """
    if spp < 2:
        raise ValueError(f"spp must be >= 2, because the variance needs two independent halves, got {spp}")
    passes = 2 * math.ceil(spp / (2 * MAX_PASS_SPP))
    wanted = math.ceil(spp / passes)
    rows = math.isqrt(wanted)
    return passes, rows * math.ceil(wanted / rows)


def view_seed(rig: Rig, i: int, seed: int, number: int) -> int:
    """Seed of one pass: a hash of the camera itself, so that the order of the views changes no pixel."""
    camera = rig.viewmats[i].tobytes() + rig.Ks[i].tobytes()
    digest = hashlib.sha256(camera + f"{rig.width}x{rig.height}:{seed}:{number}".encode()).digest()
    return int.from_bytes(digest[:4], "little")


class Passes:
    """Running mean and scatter of equal passes, float64 [h,w,3]."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.count = 0
        self.mean = np.zeros((*shape, 3))
        self.scatter = np.zeros((*shape, 3))

    def add(self, image: NDArray[Any]) -> None:
        """Welford's update: the naive sum of squares loses the variance of well-converged pixels to rounding."""
        self.count += 1
        delta = image - self.mean
        self.mean += delta / self.count
        self.scatter += delta * (image - self.mean)

    def result(self, spp_per_pass: int) -> Radiance:
        """Mean, variance of the mean, and relative error of the whole view."""
        variance = self.scatter / (self.count * (self.count - 1))
        level = float(self.mean.mean())
        error = float(np.sqrt(variance.mean())) / level if level > 0 else 0.0
        return Radiance(self.mean.astype(np.float32), variance.astype(np.float32), self.count * spp_per_pass, error)


def render_radiance(
    mi: Any,
    scene: Any,
    integrator: Any,
    rig: Rig,
    i: int,
    *,
    extent: float,
    seed: int,
    spp: int | None,
    target_error: float | None,
) -> Radiance:
    """Render view `i` with `spp` samples per pixel, or until its relative RMSE is `target_error`.

    The error seen is the spread between independent passes: noise only. It cannot see what every pass lacks, such as
    light beyond the maximal path depth, or a caustic that no pass has found yet.

    Raises:
        ValueError: If a pixel is nan, infinite or negative: the scene has an impossible emitter or reflectance.
    """
    sensor = mi.load_dict(sensor_dict(mi, rig, i, extent))
    number = 0

    def run(passes: Passes, count: int, size: int) -> None:
        nonlocal number
        for _ in range(count):
            image = mi.render(
                scene, sensor=sensor, integrator=integrator, spp=size, seed=view_seed(rig, i, seed, number)
            )
            passes.add(_checked(np.array(image, dtype=np.float64), i))
            number += 1

    shape = (rig.height, rig.width)
    if target_error is None:
        count, size = split_passes(spp or 2)
        passes = Passes(shape)
        run(passes, count, size)
        return passes.result(size)
    pilot = Passes(shape)
    run(pilot, 2, PILOT_SPP)
    needed = predict_spp(pilot.result(PILOT_SPP), target_error)
    count, size = split_passes(needed)
    passes = Passes(shape)
    run(passes, count, size)
    while passes.result(size).error > target_error and passes.count * size < MAX_SPP:
        run(passes, 2, size)
    return passes.result(size)


def predict_spp(pilot: Radiance, target_error: float) -> int:
    """Samples per pixel that bring a pilot's error down to the target, if it falls as 1/sqrt(spp)."""
    return min(max(2 * PILOT_SPP, math.ceil(pilot.spp * (pilot.error / target_error) ** 2)), MAX_SPP)


def _checked(image: NDArray[np.float64], i: int) -> NDArray[np.float64]:
    bad = ~(np.isfinite(image) & (image >= 0))
    if bad.any():
        y, x, c = (int(k) for k in np.argwhere(bad)[0])
        raise ValueError(
            f"radiance must be finite and >= 0, got {image[y, x, c]} at pixel ({x}, {y}) of view {i} "
            f"({bad.any(-1).sum()} of {bad[..., 0].size} pixels); look for a nan or negative emitter or reflectance"
        )
    return image
