"""Camera rigs and intrinsics, and the only place where camera conventions are converted.

Naming law: `viewmats` are world-to-camera [C,4,4] in OpenCV axes (x right, y down, z forward); `Ks` are intrinsics
only [C,3,3]; pixel centres lie at +0.5; `c2w` is camera-to-world; `to_world` is Mitsuba's (x left, y up, z forward).
World z is up. Lengths are in scene units, angles in degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

# Float32 poses from other tools round to 1e-6; a scaled or mirrored pose is off by far more.
MAX_ROTATION_ERROR = 1e-4
MAX_SKEW = 1e-6  # of the focal length: rounding
TEST_EVERY = 8  # gsplat, mip-NeRF 360 and LLFF loaders hold out every 8th sorted view, starting at the first

_OPENCV_TO_MITSUBA = np.diag([-1.0, -1.0, 1.0, 1.0])
_OPENCV_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Rig:
    """Pinhole cameras that share one image size.

    Attributes:
        viewmats: World-to-camera, OpenCV axes. float64 [C,4,4], rigid.
        Ks: Intrinsics in pixels, zero skew, pixel centres at +0.5. float64 [C,3,3].
        width: Image width in pixels.
        height: Image height in pixels.

    Raises:
        ValueError: If a shape is wrong, a value is not finite, a pose is not rigid, a focal length is not positive or
            intrinsics are not of a pinhole without skew.
    """

    viewmats: Float
    Ks: Float
    width: int
    height: int

    def __post_init__(self) -> None:
        viewmats = np.array(self.viewmats, dtype=np.float64)
        Ks = np.array(self.Ks, dtype=np.float64) + 0.0  # -0 becomes 0: equal intrinsics have equal bytes
        if viewmats.ndim != 3 or viewmats.shape[1:] != (4, 4) or Ks.shape != (len(viewmats), 3, 3):
            raise ValueError(f"Rig: viewmats must be [C,4,4] and Ks [C,3,3], got {viewmats.shape} and {Ks.shape}")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"Rig: width and height must be >= 1 pixel, got {self.width} x {self.height}")
        if not (np.isfinite(viewmats).all() and np.isfinite(Ks).all()):
            raise ValueError("Rig: viewmats and Ks must be finite; check the camera file for nan or inf")
        if not (error := rotation_error(viewmats[:, :3, :3])) <= MAX_ROTATION_ERROR:
            raise ValueError(f"Rig: every viewmat must be a rotation and a translation (no scale, no mirror); "
                             f"R R^T differs from the identity by {error:.3g}")  # fmt: skip
        if np.abs(viewmats[:, 3] - [0, 0, 0, 1]).max(initial=0.0) > MAX_ROTATION_ERROR:
            raise ValueError("Rig: every viewmat must end in the row 0 0 0 1, from world to camera; is it transposed?")
        if (Ks[:, [0, 1], [0, 1]] <= 0).any():
            raise ValueError("Rig: focal lengths Ks[:,0,0] and Ks[:,1,1] must be > 0 pixels")
        fixed = np.abs(Ks[:, [0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] - [0, 0, 0, 0, 1])
        if (odd := (fixed > MAX_SKEW * Ks[:, 0, :1]).any(1)).any():
            raise ValueError(f"Rig: Ks must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], without skew, got "
                             f"{Ks[odd.argmax()].tolist()}; is it transposed?")  # fmt: skip
        viewmats.setflags(write=False)
        Ks.setflags(write=False)
        object.__setattr__(self, "viewmats", viewmats)
        object.__setattr__(self, "Ks", Ks)

    def __len__(self) -> int:
        return len(self.viewmats)

    @property
    def positions(self) -> Float:
        """Camera centres in the world, [C,3]."""
        rotations, translations = self.viewmats[:, :3, :3], self.viewmats[:, :3, 3]
        return -np.einsum("cij,ci->cj", rotations, translations)

    def about(self, origin: ArrayLike) -> Rig:
        """The same cameras in a world whose zero lies at `origin` [3] of this one."""
        viewmats = self.viewmats.copy()
        viewmats[:, :3, 3] += viewmats[:, :3, :3] @ np.asarray(origin, np.float64)
        return replace(self, viewmats=viewmats)

    def project(self, points: ArrayLike) -> tuple[Float, Float]:
        """Project world points [P,3]: pixels [C,P,2] and z-depths [C,P], negative behind the camera."""
        points = np.asarray(points, dtype=np.float64)
        in_camera = np.einsum("cij,pj->cpi", self.viewmats[:, :3, :3], points) + self.viewmats[:, None, :3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            homogeneous = np.einsum("cij,cpj->cpi", self.Ks, in_camera)
            pixels = homogeneous[..., :2] / homogeneous[..., 2:]
        return pixels, in_camera[..., 2]


def rotation_error(matrices: Float) -> float:
    """How far the worst of [...,3,3] is from a rotation: the largest entry of |R R^T - 1|; inf for a mirror."""
    with np.errstate(all="ignore"):  # entries of 1e300: inf or nan, which is not a rotation either
        error = float(np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(initial=0.0))
        return np.inf if (np.linalg.det(matrices) < 0).any() else error


def unproject(rig: Rig, i: int, z: ArrayLike, pixels: NDArray[np.intp]) -> Float:
    """World points [n,3] of pixel centres (flat indices [n]) of view `i`, from its z-depth [h,w]."""
    y, x = np.divmod(pixels, rig.width)
    K, depth = rig.Ks[i], np.asarray(z).ravel()[pixels].astype(np.float64)
    local = np.stack([(x + 0.5 - K[0, 2]) / K[0, 0] * depth, (y + 0.5 - K[1, 2]) / K[1, 1] * depth, depth], -1)
    c2w = invert_rigid(rig.viewmats[i])
    return local @ c2w[:3, :3].T + c2w[:3, 3]


def invert_rigid(pose: ArrayLike) -> Float:
    """Invert rigid transforms [...,4,4] exactly (transpose), not by a general solve."""
    pose = np.asarray(pose, dtype=np.float64)
    inverse = np.zeros_like(pose)
    inverse[..., :3, :3] = np.swapaxes(pose[..., :3, :3], -1, -2)
    inverse[..., :3, 3] = -np.einsum("...ij,...j->...i", inverse[..., :3, :3], pose[..., :3, 3])
    inverse[..., 3, 3] = 1.0
    return inverse


def opencv_to_mitsuba(viewmats: ArrayLike) -> Float:
    """World-to-camera OpenCV [...,4,4] -> Mitsuba `to_world` [...,4,4]."""
    return invert_rigid(viewmats) @ _OPENCV_TO_MITSUBA


def mitsuba_to_opencv(to_world: ArrayLike) -> Float:
    """Mitsuba `to_world` [...,4,4] -> world-to-camera OpenCV [...,4,4]."""
    return invert_rigid(np.asarray(to_world, dtype=np.float64) @ _OPENCV_TO_MITSUBA)


def opencv_to_opengl(viewmats: ArrayLike) -> Float:
    """World-to-camera OpenCV [...,4,4] -> camera-to-world OpenGL [...,4,4] (x right, y up, z backward)."""
    return invert_rigid(viewmats) @ _OPENCV_TO_OPENGL


def opengl_to_opencv(c2w: ArrayLike) -> Float:
    """Camera-to-world OpenGL [...,4,4] -> world-to-camera OpenCV [...,4,4]."""
    return invert_rigid(np.asarray(c2w, dtype=np.float64) @ _OPENCV_TO_OPENGL)


def intrinsics(width: int, height: int, fov_x_deg: float) -> Float:
    """Intrinsics [3,3] of a centred pinhole camera with square pixels; `fov_x_deg` spans the image width."""
    if not 0.0 < fov_x_deg < 180.0:
        raise ValueError(f"fov_x_deg must lie between 0 and 180 degrees, got {fov_x_deg}")
    focal = 0.5 * width / np.tan(np.radians(fov_x_deg) / 2)
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=np.float64)


def intrinsics_to_mitsuba(K: ArrayLike, width: int, height: int) -> tuple[float, float, float]:
    """Intrinsics [3,3] -> Mitsuba's (fov_x in degrees, principal_point_offset_x, principal_point_offset_y).

    Raises:
        ValueError: If pixels are not square or the axes are skewed: Mitsuba's perspective sensor has neither.
    """
    K = np.asarray(K, dtype=np.float64)
    if abs(K[0, 0] / K[1, 1] - 1) > 1e-6 or abs(K[0, 1]) > 1e-9 * K[0, 0]:
        raise ValueError(f"K must have square pixels and no skew to be rendered, got fx {K[0, 0]}, fy {K[1, 1]}, "
                         f"skew {K[0, 1]}; undistort and rescale the camera first")  # fmt: skip
    fov_x = np.degrees(2 * np.arctan(width / 2 / K[0, 0]))
    return float(fov_x), float(0.5 - K[0, 2] / width), float(0.5 - K[1, 2] / height)


def mitsuba_to_intrinsics(fov_x_deg: float, ppx: float, ppy: float, width: int, height: int) -> Float:
    """Inverse of `intrinsics_to_mitsuba`: intrinsics [3,3] in pixels."""
    K = intrinsics(width, height, fov_x_deg)
    K[0, 2], K[1, 2] = width * (0.5 - ppx), height * (0.5 - ppy)
    return K


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Float:
    """World-to-camera OpenCV [4,4] of a camera at `position` that looks at `target`, image y opposite to `up`.

    Raises:
        ValueError: If position and target coincide, or `up` is parallel to the viewing direction.
    """
    position, target, up = np.array(position, float), np.array(target, float), np.array(up, float)
    forward = target - position
    right = np.cross(forward, up)
    # Below 1e-9 of the product of lengths the cross product is rounding noise and the roll is undefined.
    if np.linalg.norm(right) <= 1e-9 * float(np.linalg.norm(forward) * np.linalg.norm(up)):
        raise ValueError(f"look_at: position and target must differ and not be in line with up, "
                         f"got position {position.tolist()}, target {target.tolist()}")  # fmt: skip
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    c2w = np.eye(4)
    c2w[:3, 0], c2w[:3, 1], c2w[:3, 2], c2w[:3, 3] = right, np.cross(forward, right), forward, position
    return invert_rigid(c2w)


def _rig(positions: Float, target: Sequence[float], width: int, height: int, fov_x_deg: float) -> Rig:
    viewmats = np.stack([look_at(p, target) for p in positions])
    Ks = np.repeat(intrinsics(width, height, fov_x_deg)[None], len(positions), axis=0)
    return Rig(viewmats=viewmats, Ks=Ks, width=width, height=height)


def _check_views(n_views: int) -> None:
    if n_views < 1:
        raise ValueError(f"n_views must be >= 1, got {n_views}")


def there_and_back(n: int) -> NDArray[np.intp]:
    """Order of n positions on a line: every second one on the way out, the others on the way back, starting in between.

    Every 8th view is held out, and at an end of the line it would ask any method to extrapolate: the loop starts where
    neither end gets such an index.
    """
    loop = np.array([*range(0, n, 2), *reversed(range(1, n, 2))])
    ends = np.flatnonzero((loop == 0) | (loop == n - 1))
    starts = range(n // 4, n // 4 + n)
    # up to two positions, there are only ends
    start = next((s for s in starts if ((ends - s) % n % TEST_EVERY != 0).all()), 0)
    return np.roll(loop, -start)


def orbit_rig(
    n_views: int,
    width: int,
    height: int,
    fov_x_deg: float,
    *,
    target: Sequence[float] = (0.0, 0.0, 0.0),
    radius: float,
    elevation_deg: float = 25.0,
    swing_deg: float = 10.0,
    waves: float = 3.0,
    start_deg: float = 0.0,
    sweep_deg: float = 360.0,
) -> Rig:
    """Cameras on an orbit around `target`, all looking at it, their height following a wave.

    Args:
        n_views: Number of cameras, evenly spaced in azimuth. On an arc they are numbered out and back, so that no
            test view lies at an end of it.
        width: Image width in pixels.
        height: Image height in pixels.
        fov_x_deg: Horizontal field of view.
        target: Point looked at, scene units [3].
        radius: Distance from target to every camera, scene units.
        elevation_deg: Mean elevation above the horizontal plane.
        swing_deg: Amplitude of the wave in elevation.
        waves: Periods of that wave over the sweep.
        start_deg: Azimuth where ring or arc begins, from +x towards +y.
        sweep_deg: Azimuth covered; below 360 both ends are used, a full ring does not repeat its first camera.

    Returns:
        The rig; neighbours in index are neighbours in space.

    Raises:
        ValueError: If `n_views` < 1, `radius` <= 0 or an elevation reaches a pole.
    """
    _check_views(n_views)
    if radius <= 0 or abs(elevation_deg) + abs(swing_deg) >= 89.9:
        raise ValueError(f"orbit_rig: radius must be > 0 and elevation with swing inside +-89.9 degrees, "
                         f"got {radius} and {elevation_deg} +- {swing_deg}")  # fmt: skip
    is_ring = abs(sweep_deg) >= 360.0
    t = np.arange(n_views) / n_views if is_ring else there_and_back(n_views) / max(n_views - 1, 1)
    azimuth = np.radians(start_deg + sweep_deg * t)
    elevation = np.radians(elevation_deg + swing_deg * np.sin(2 * np.pi * waves * t))
    offsets = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], 1)
    return _rig(np.asarray(target, dtype=np.float64) + radius * offsets, target, width, height, fov_x_deg)


def forward_rig(
    n_views: int,
    width: int,
    height: int,
    fov_x_deg: float,
    *,
    position: Sequence[float],
    target: Sequence[float],
    extent: tuple[float, float],
    rows: int = 3,
) -> Rig:
    """Forward-facing cameras: a zigzag over a flat window around `position`, all looking at `target`.

    Args:
        n_views: Number of cameras, numbered out and back along the zigzag, so that no test view lies at an end of it.
        width: Image width in pixels.
        height: Image height in pixels.
        fov_x_deg: Horizontal field of view.
        position: Centre of the window, scene units [3].
        target: Point looked at, scene units [3].
        extent: Half width and half height of the window, scene units.
        rows: Passes of the zigzag from bottom to top.

    Raises:
        ValueError: If `n_views` or `rows` < 1, or the viewing direction is undefined.
    """
    _check_views(n_views)
    if rows < 1:
        raise ValueError(f"forward_rig: rows must be >= 1, got {rows}")
    right, down = look_at(position, target)[:2, :3]
    t = there_and_back(n_views) / (n_views - 1) if n_views > 1 else np.array([0.5])
    triangle = 1.0 - 2.0 * np.abs((rows * t) % 2.0 - 1.0)
    window = extent[0] * triangle[:, None] * right - extent[1] * (2 * t[:, None] - 1) * down
    return _rig(np.asarray(position, dtype=np.float64) + window, target, width, height, fov_x_deg)
