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

from simscenes.camera import camera_color
from simscenes.optics import Optics
from simscenes.render.motion import subframe_rig
from simscenes.render.source import LoadedScene
from simscenes.rigs import Rig, intrinsics_to_mitsuba, opencv_to_mitsuba

MAX_PASS_SPP = 1024
MAX_SPP = 65536  # where target_error gives up
PILOT_SPP = 16
MAX_INTERFACES = 64
PINHOLE = Optics()


@dataclass(frozen=True)
class Radiance:
    """What the passes of one view add up to.

    Attributes:
        mean: Radiance, float32 [h,w,3].
        variance: Estimated variance of `mean`, float32 [h,w,3]; unbiased, but from few passes, so noisy per pixel.
        spp: Samples per pixel behind `mean`.
        error: Relative RMSE: root of the mean variance over the mean radiance.
        fireflies: Pixels whose variance is far above that of their neighbourhood: rare bright paths.
    """

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    spp: int
    error: float
    fireflies: int


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


def sensor_dict(mi: Any, rig: Rig, i: int, loaded: LoadedScene, optics: Optics = PINHOLE) -> dict[str, Any]:
    """Mitsuba sensor of view `i`: box filter (others leak between pixels and are not repeatable), float32 film.

    Args:
        mi: The mitsuba module.
        rig: The cameras.
        i: Which one.
        loaded: The scene; its size sets the clip planes, its fog may surround the camera.
        optics: Lens and colour filters.
    """
    fov, ppx, ppy = intrinsics_to_mitsuba(rig.Ks[i], rig.width, rig.height)
    lens: dict[str, Any] = {"type": "perspective", "principal_point_offset_x": ppx, "principal_point_offset_y": ppy}
    if optics.aperture_radius is not None:
        if max(abs(ppx), abs(ppy)) > 1e-9:
            raise ValueError(f"Mitsuba's thin lens has its principal point in the image centre, got an offset of "
                             f"({ppx:.3g}, {ppy:.3g}) image sizes; centre it or use a pinhole")  # fmt: skip
        lens = {"type": "thinlens", "aperture_radius": optics.aperture_radius, "focus_distance": optics.focus_distance}
    medium = medium_at(mi, loaded, rig.positions[i])
    if medium is not None:
        lens["medium"] = medium
    size = {"width": rig.width, "height": rig.height, "rfilter": {"type": "box"}, "component_format": "float32"}
    film = {"type": "hdrfilm", "pixel_format": "rgb", **size}
    if optics.camera is not None and "spectral" in mi.variant():
        film = camera_color(optics.camera).film(rig.width, rig.height)
    return {
        **lens,
        "fov": fov,
        "fov_axis": "x",
        "near_clip": 1e-4 * loaded.extent,
        "far_clip": 1e2 * loaded.extent,
        "to_world": mi.ScalarTransform4f(opencv_to_mitsuba(rig.viewmats[i])),
        "sampler": {"type": "multijitter", "sample_count": PILOT_SPP},
        "film": film,
    }


def medium_at(mi: Any, loaded: LoadedScene, position: NDArray[np.float64]) -> Any:
    """The medium around a point, or None: a camera in fog has to be told so.

    Found from the first border of a medium along +z; other surfaces in between are passed through.
    """
    scene = loaded.scene
    borders = [s for s in scene.shapes() if s.is_medium_transition()]
    if not borders:
        return None
    ray = mi.Ray3f(mi.Point3f(*(float(v) for v in position)), mi.Vector3f(0, 0, 1))
    for _ in range(MAX_INTERFACES):
        si = scene.ray_intersect(ray)
        if not np.array(si.is_valid()).all():
            return None
        shape = si.shape if mi.variant().startswith("scalar") else si.shape[0]
        if shape.is_medium_transition():
            return shape.interior_medium() if np.array(si.n.z).item() > 0 else shape.exterior_medium()
        ray = si.spawn_ray(ray.d)
    return None


def pass_spp(spp: float) -> int:
    """The largest power of four that is at most `spp` (and at least 1).

    Only these sizes repeat bit by bit: they fit the sampler's grid, and the samples of one pixel never straddle two
    work units of Dr.Jit, whose threads would add to the pixel in an order that changes from run to run.
    """
    return int(4 ** max(0, math.floor(math.log2(max(spp, 1)) / 2)))


def split_passes(spp: int) -> tuple[int, int]:
    """Number of passes (at least 2) and samples per pixel of each, together at least `spp`."""
    if spp < 2:
        raise ValueError(f"spp must be >= 2, because the variance needs two independent passes, got {spp}")
    size = min(pass_spp(spp / 2), MAX_PASS_SPP)
    return math.ceil(spp / size), size


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
        return Radiance(
            mean=self.mean.astype(np.float32),
            variance=variance.astype(np.float32),
            spp=self.count * spp_per_pass,
            error=error,
            fireflies=count_fireflies(variance.mean(-1), level),
        )


def count_fireflies(variance: NDArray[Any], level: float) -> int:
    """Pixels [h,w] with 50 times the median variance around them, if that is more than 5 % of the mean radiance."""
    from scipy.ndimage import median_filter

    around = median_filter(variance, size=5, mode="nearest")
    return int(((variance > 50 * around) & (variance > (0.05 * level) ** 2)).sum())


class View:
    """One view, ready to be rendered in passes."""

    def __init__(self, method: Method, rig: Rig, i: int) -> None:
        self.method, self.rig, self.i, self.number = method, rig, i, 0
        frames = rig if method.subframes == 1 else subframe_rig(rig, i, method.optics.motion or 0.0, method.subframes)
        views = [i] if method.subframes == 1 else range(len(frames))
        mi = method.mi
        self.sensors = [mi.load_dict(sensor_dict(mi, frames, k, method.loaded, method.optics)) for k in views]

    def run(self, passes: Passes, count: int, size: int) -> None:
        """Add `count` passes of `size` samples per pixel, spread over the sub-frames (at least one in each)."""
        mi, each = self.method.mi, pass_spp(size / len(self.sensors))
        for _ in range(count):
            image = np.zeros((self.rig.height, self.rig.width, 3))
            for sensor in self.sensors:
                seed = view_seed(self.rig, self.i, self.method.seed, self.number)
                film = mi.render(
                    self.method.loaded.scene, sensor=sensor, integrator=self.method.integrator, spp=each, seed=seed
                )
                image += np.array(film, dtype=np.float64)[..., :3] / len(self.sensors)
                self.number += 1
            passes.add(self._in_camera_rgb(image))

    def _in_camera_rgb(self, image: NDArray[np.float64]) -> NDArray[np.float64]:
        spectral = "spectral" in self.method.variant
        if self.method.optics.camera is None:
            # Spectral light may lie outside the triangle of sRGB, where a channel is negative.
            return check_radiance(image, self.i, signed=spectral)
        camera = camera_color(self.method.optics.camera)
        check_radiance(image, self.i)
        if spectral:
            return image / camera.green_integral
        return np.clip(image @ camera.matrix.T, 0, None)  # the matrix makes colours no filter can see negative

    def render(self, spp: int | None, target_error: float | None) -> Radiance:
        """Render with `spp` samples per pixel, or until the relative RMSE is `target_error`.

        The error seen is the spread between independent passes: noise only. It cannot see what every pass lacks, such
        as light beyond the maximal path depth, or a caustic that no pass has found yet.

        Raises:
            ValueError: If a pixel is nan, infinite or negative: the scene has an impossible emitter or reflectance.
        """
        if target_error is not None:
            spp = self.predict_spp(target_error)
        count, size = split_passes(spp or 2)
        size = max(size, len(self.sensors))  # both powers of four: each sub-frame gets its whole share
        passes = Passes((self.rig.height, self.rig.width))
        self.run(passes, count, size)
        while target_error is not None and passes.result(size).error > target_error and passes.count * size < MAX_SPP:
            self.run(passes, 2, size)
        return passes.result(size)

    def predict_spp(self, target_error: float) -> int:
        """Samples per pixel that bring a pilot's error down to the target, if it falls as 1/sqrt(spp)."""
        pilot = Passes((self.rig.height, self.rig.width))
        size = max(PILOT_SPP, len(self.sensors))
        self.run(pilot, 2, size)
        seen = pilot.result(size)
        wanted = seen.spp * (seen.error / target_error) ** 2
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
