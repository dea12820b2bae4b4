"""Lenses with OpenCV distortion: what their pictures look like through a pinhole, and where their model ends.

A ray at x, y (z = 1) of radius r falls on the picture at x R + 2 p1 xy + p2 (r^2 + 2 x^2) and y R + p1 (r^2 + 2 y^2) +
2 p2 xy, times the focal lengths, with R = 1 + k1 r^2 + k2 r^4 + k3 r^6. Such a polynomial may turn: beyond some radius,
rays farther out fall farther in, on pixels that nearer rays fall on as well. No pixel of a pinhole picture looks there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import polynomial as poly
from numpy.typing import NDArray

Float = NDArray[np.float64]
DIRECTIONS = 36  # in which the turn is looked for, where tangential terms make it depend on the direction
SAMPLES = 101  # of a side
SLACK = 1.0  # px that a pinhole by OpenCV may look beyond the picture: it tests nine points a side
NEAR_TURN = 0.995  # of the turning radius; at the turn itself one pixel is drawn out without end
MOST_FOLDED = 0.20  # of a picture beyond the turn; a calibration that explains less is not of this lens
LEAST = 1e-3  # of the field of view


@dataclass(frozen=True)
class DistortedPinhole:
    """A pinhole with OpenCV distortion: K [3,3] (pixel centres at +0.5) and (k1, k2, p1, p2, k3)."""

    K: Float
    distortion: tuple[float, float, float, float, float]

    def pinhole(self, width: int, height: int) -> Float:
        """Intrinsics [3,3] of the largest undistorted image of this size without empty borders.

        Raises:
            ValueError: If more than `MOST_FOLDED` of the picture lies beyond the turn, or no such image exists.
        """
        if not any(self.distortion):
            return self.K
        if (share := self.folded(width, height)) > MOST_FOLDED:
            raise ValueError(self._refusal(share))
        import cv2

        shifted, _ = cv2.getOptimalNewCameraMatrix(_to_cv(self.K), np.array(self.distortion), (width, height), 0)
        found = _from_cv(shifted)
        # OpenCV undoes distortion by steps that lead anywhere near a turn.
        return found if self._shows(found, width, height, SLACK) else self._inscribed(width, height)

    def undistort(self, image: NDArray[np.uint8], pinhole: Float) -> NDArray[np.uint8]:
        """Resample a distorted image [h,w,3] to the pinhole camera `pinhole` [3,3]."""
        if not any(self.distortion):
            return image
        import cv2

        return cv2.undistort(image, _to_cv(self.K), np.array(self.distortion), newCameraMatrix=_to_cv(pinhole))

    def folded(self, width: int, height: int) -> float:
        """Share of a picture of this size, 0 to 1, that lies beyond the turn, where no ray belongs to a pixel."""
        turn = turning(self.distortion)
        if not np.isfinite(turn).any():
            return 0.0
        x, y = np.meshgrid((np.arange(SAMPLES) + 0.5) * width / SAMPLES, (np.arange(SAMPLES) + 0.5) * height / SAMPLES)
        seen = np.stack([(x - self.K[0, 2]) / self.K[0, 0], (y - self.K[1, 2]) / self.K[1, 1]], -1)
        edge = distorted(_rays(np.where(np.isfinite(turn), turn, 1e6)), self.distortion)
        angle = np.arctan2(edge[:, 1], edge[:, 0])
        order = np.argsort(angle)
        with np.errstate(over="ignore"):
            radius = np.where(np.isfinite(turn), np.hypot(*edge.T), np.inf)[order]
        most = np.interp(np.arctan2(seen[..., 1], seen[..., 0]), angle[order], radius, period=2 * np.pi)
        return float((np.hypot(seen[..., 0], seen[..., 1]) > most).mean())

    def _shows(self, pinhole: Float, width: int, height: int, slack: float) -> bool:
        """Whether every pixel of a pinhole picture looks into the picture, up to `slack` px, and before the turn.

        The border is enough: the rays before the turn that fall into the picture leave no hole.
        """
        if not (np.isfinite(pinhole).all() and (np.diag(pinhole) > 0).all()):
            return False
        rays = (_border(width, height) - pinhole[:2, 2]) / np.diag(pinhole)[:2]
        turn = turning(self.distortion)
        every = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
        most = np.interp(np.arctan2(rays[:, 1], rays[:, 0]), every, np.minimum(turn, 1e6), period=2 * np.pi)
        at = distorted(rays, self.distortion) * np.diag(self.K)[:2] + self.K[:2, 2]
        inside = (at >= 0.5 - slack).all() and (at <= np.array([width, height]) - 0.5 + slack).all()
        return bool(inside and (np.hypot(*rays.T) <= most * NEAR_TURN).all())

    def _inscribed(self, width: int, height: int) -> Float:
        """The widest pinhole with the centre of this lens, and its ratio of the focal lengths, that shows no border."""
        low, high = LEAST, 8.0  # tangents of the field of view, of those without distortion
        if not self._shows(self._narrowed(low), width, height, 0.0):
            raise ValueError(
                f"the distortion of a lens ({self._terms()}) cannot be undone: no pinhole around its centre sees a "
                "part of the picture; calibrate again, or undistort the images first"
            )
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (middle, high) if self._shows(self._narrowed(middle), width, height, 0.0) else (low, middle)
        return self._narrowed(low)

    def _narrowed(self, factor: float) -> Float:
        return self.K * np.array([[1 / factor, 1, 1], [1, 1 / factor, 1], [1, 1, 1]])

    def _terms(self) -> str:
        named = zip(("k1", "k2", "p1", "p2", "k3"), self.distortion, strict=True)
        return ", ".join(f"{name} = {value:.4g}" for name, value in named if value)

    def _refusal(self, share: float) -> str:
        return (f"the distortion of a lens ({self._terms()}) turns {self.turn_px():.0f} px from its centre: rays "
                f"farther out fall back on pixels farther in, so that {share:.0%} of the picture, of at most "
                f"{MOST_FOLDED:.0%}, belongs to no ray; calibrate a lens this wide with more terms (k1 and k2, or a "
                "fisheye), and undistort the images first")  # fmt: skip

    def turn_px(self) -> float:
        """Radius in the picture at which the distortion turns, in the direction where it is least, px; inf: nowhere."""
        turn = turning(self.distortion)
        if not np.isfinite(turn).any():
            return np.inf
        at = distorted(_rays(np.where(np.isfinite(turn), turn, 0.0)), self.distortion) * np.diag(self.K)[:2]
        return float(np.hypot(*at[np.isfinite(turn)].T).min())


def distorted(rays: Float, distortion: tuple[float, ...]) -> Float:
    """Where rays [..., 2] (x, y at z = 1) fall, in focal lengths from the centre."""
    k1, k2, p1, p2, k3 = distortion
    x, y = rays[..., 0], rays[..., 1]
    with np.errstate(over="ignore", invalid="ignore"):  # rays far beyond any picture
        square = x * x + y * y
        factor = 1 + square * (k1 + square * (k2 + square * k3))
        return np.stack([x * factor + 2 * p1 * x * y + p2 * (square + 2 * x * x),
                         y * factor + p1 * (square + 2 * y * y) + 2 * p2 * x * y], -1)  # fmt: skip


@lru_cache(maxsize=1024)
def turning(distortion: tuple[float, ...]) -> Float:
    """The radius of a ray (at z = 1) at which distortion first turns, in `DIRECTIONS` directions; inf: nowhere.

    It turns where the determinant of its derivative is 0. Along a direction that is a polynomial of the radius.
    """
    k1, k2, p1, p2, k3 = distortion
    radial, slope = [1, 0, k1, 0, k2, 0, k3], [0, 0, 2 * k1, 0, 4 * k2, 0, 6 * k3]
    count = DIRECTIONS if p1 or p2 else 1
    found = np.full(count, np.inf)
    for i, (c, s) in enumerate(_rays(np.ones(count))):
        xx = poly.polyadd(poly.polyadd(radial, np.multiply(slope, c * c)), [0, 2 * p1 * s + 6 * p2 * c])
        yy = poly.polyadd(poly.polyadd(radial, np.multiply(slope, s * s)), [0, 6 * p1 * s + 2 * p2 * c])
        xy = poly.polyadd(np.multiply(slope, c * s), [0, 2 * p1 * c + 2 * p2 * s])
        roots = poly.polyroots(poly.polytrim(poly.polysub(poly.polymul(xx, yy), poly.polymul(xy, xy))))
        real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)]
        found[i] = real.min(initial=np.inf)
    found = np.full(DIRECTIONS, found[0]) if count == 1 else found
    found.setflags(write=False)
    return found


def _rays(radius: Float) -> Float:
    """Rays [n,2] of these radii, one in each of n directions."""
    angle = np.arange(len(radius)) * 2 * np.pi / len(radius)
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)


def _border(width: int, height: int) -> Float:
    """Centres of pixels along the border of a picture [n,2]."""
    x, y = np.linspace(0.5, width - 0.5, SAMPLES), np.linspace(0.5, height - 0.5, SAMPLES)
    sides = [np.stack(np.broadcast_arrays(x, at), -1) for at in (0.5, height - 0.5)]
    sides += [np.stack(np.broadcast_arrays(at, y), -1) for at in (0.5, width - 0.5)]
    return np.concatenate(sides)


def _to_cv(K: Float) -> Float:
    return K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV counts pixel centres from 0


def _from_cv(K: Float) -> Float:
    return K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
