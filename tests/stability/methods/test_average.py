"""Hard cases of the average over views: variances far apart, worlds of any size, surfaces seen from the side or absent.

The surface is a plane parallel to all pictures and the light on it linear, so that cubic convolution is exact and every
exposure and its average have a closed form.
"""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from novags.methods.averaging import scene, surface, warp
from novags.methods.averaging.scene import Average, AveragedScene, average
from novags.methods.averaging.surface import SurfaceCamera
from novags.methods.averaging.warp import Rules
from tests.stability.case import LARGEST, Case, Error, Fails, Part, Setting, relative_error, worst_error

PART = Part("average")
HERE = sys.modules[__name__]  # where the cases find what a test replaces

EPS = float(np.finfo(np.float64).eps)
NUMPY = ("numpy",)
HEIGHT, WIDTH, FOCAL = 11, 14, 16.0
SHIFTS = [(0.0, 0.0), (0.3, -0.4), (-0.7, 0.2), (1.6, 1.1)]  # of the cameras, in pixels
SLOPES = np.array([[0.02, 0.01], [-0.015, 0.03], [0.0, 0.0]])  # of the light, per pixel, of each channel
INNER = np.s_[4:-4, 4:-4]  # where no kernel reaches beyond a rim
Array = np.ndarray


def _camera(
    shift: tuple[float, float], depth: float, normal: tuple[float, float, float] = (0.0, 0.0, -1.0)
) -> SurfaceCamera:
    """Parallel to the plane at this depth, which moves by `shift` pixels in its picture."""
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
    viewmat = np.eye(4)
    viewmat[:2, 3] = np.array(shift) * (1.0 if np.isinf(depth) else depth) / FOCAL
    size = (HEIGHT, WIDTH)
    return SurfaceCamera.of(viewmat, K, np.full(size, depth), np.broadcast_to(np.array(normal), (*size, 3)))


def _light(shift: tuple[float, float]) -> Array:
    """What a camera sees of the linear light [h, w, 3]."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return 0.5 + (x - shift[0])[..., None] * SLOPES[:, 0] + (y - shift[1])[..., None] * SLOPES[:, 1]


def _squares(shift: tuple[float, float]) -> float:
    """Sum of the squared weights of cubic convolution, in the middle of the picture."""
    total = 1.0
    for fraction in (shift[0] % 1, shift[1] % 1):
        x = np.abs(fraction - np.arange(-1, 3))
        inner, outer = 1.5 * x**3 - 2.5 * x**2 + 1, -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
        total *= float((np.where(x <= 1, inner, np.where(x < 2, outer, 0.0)) ** 2).sum())
    return total


def _error(found: Average, variances: list[float], offsets: list[float]) -> float:
    """Error of the average of exposures that are too bright by `offsets`, and of its variance; the target is not."""
    weights = [1 / (variance * _squares(shift)) for variance, shift in zip(variances, SHIFTS, strict=True)]
    bias = sum(weight * offset for weight, offset in zip(weights, offsets, strict=True)) / sum(weights)
    mean = (_light((0.0, 0.0)) + bias)[INNER]
    seen, spread = (part.reshape(HEIGHT, WIDTH, 3)[INNER] for part in (found.mean, found.variance))
    return worst_error([(seen, mean), (spread, np.full_like(mean, 1 / sum(weights)))])


def _averaged(depth: float, variances: list[float], offsets: list[float]) -> float:
    cameras = [_camera(shift, depth) for shift in SHIFTS]
    exposures = np.stack([_light(shift) + offset for shift, offset in zip(SHIFTS, offsets, strict=True)])
    noise = np.stack([np.full((HEIGHT, WIDTH, 3), variance) for variance in variances])
    # And one that sees another surface, at half the distance, and must not count.
    cameras.append(_camera((0.0, 0.0), depth / 2))
    exposures, noise = (np.concatenate([part, np.full_like(part[:1], 1e-3)]) for part in (exposures, noise))
    exposures[-1] = 1e3
    return _error(average(_camera((0.0, 0.0), depth), cameras, exposures, noise, Rules()), variances, offsets)


@PART.case("variances from 1e-12 to 1e6", bound=1e4 * EPS, unit=LARGEST, backends=NUMPY)
def variances(setting: Setting) -> float:
    """The best exposure alone decides, whichever it is; the worst is off by a thousand times the light."""
    worst = 0.0
    for best in range(4):
        spread = [1e6 if k == (best + 1) % 4 else 1.0 for k in range(4)]
        spread[best] = 1e-12
        offsets = [1e3 if value == 1e6 else 0.1 for value in spread]
        offsets[best] = 0.0
        worst = max(worst, _averaged(2.0, spread, offsets))
    return worst


@PART.case("exposures as good as each other", bound=1e4 * EPS, unit=LARGEST, backends=NUMPY)
def alike(setting: Setting) -> float:
    """Each weighs by what the kernel leaves of its noise: a view between pixels is smoother than one on them."""
    return max(_averaged(2.0, [v] * 4, [0.3, -0.2, 0.1, -0.4]) for v in (1e-30, 1e-6, 1.0, 1e30))


@PART.case("worlds from 1e-9 to 1e9 in size", bound=1e4 * EPS, unit=LARGEST, backends=NUMPY)
def size(setting: Setting) -> float:
    """Light years or nanometres: the picture is the same."""
    return max(_averaged(depth, [0.1, 0.2, 0.3, 0.4], [0.1, 0.0, -0.1, 0.2]) for depth in (1e-9, 1e-3, 1e3, 1e9))


@PART.case("no surface: a background infinitely far away", bound=1e4 * EPS, unit=LARGEST, backends=NUMPY)
def background(setting: Setting) -> float:
    """Cameras that moved see it in the same place."""
    cameras = [_camera(shift, np.inf) for shift in SHIFTS]
    exposures = np.stack([_light((0.0, 0.0)) + offset for offset in (0.3, -0.1, 0.2, 0.0)])
    found = average(cameras[0], cameras, exposures, np.ones_like(exposures), Rules())
    return worst_error(
        [
            (found.mean.reshape(HEIGHT, WIDTH, 3), _light((0.0, 0.0)) + 0.1),
            (found.variance, np.full_like(found.variance, 0.25)),
        ]
    )


@PART.case("a surface seen exactly from the side", bound=1e4 * EPS, unit=LARGEST, backends=NUMPY)
def grazing(setting: Setting) -> float:
    """Its tangent plane contains the rays, and its inverse depth has no value: it is taken as facing the camera."""
    cameras = [_camera(shift, 2.0, (0.0, 1.0, 0.0)) for shift in SHIFTS]
    exposures = np.stack([_light(shift) for shift in SHIFTS])
    found = average(cameras[0], cameras, exposures, np.ones_like(exposures), Rules())
    worst = relative_error(np.isfinite(found.mean), np.ones_like(found.mean))
    middle = found.mean.reshape(HEIGHT, WIDTH, 3)[HEIGHT // 2, 4:-4]  # the row that looks along the surface
    return max(worst, relative_error(middle, _light((0.0, 0.0))[HEIGHT // 2, 4:-4]))


@PART.case("pixels that no exposure sees", bound=0, unit=LARGEST, backends=NUMPY)
def unseen(setting: Setting) -> float:
    """Everything behind the cameras, and nothing but: mean 0, variance infinite, and never 0 / 0."""
    ahead, behind = _camera((0.0, 0.0), 2.0), _camera((0.0, 0.0), 2.0)
    behind.viewmat[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    light = _light((0.0, 0.0))[None]
    found = average(behind, [ahead], light, np.ones_like(light), Rules())
    scene = AveragedScene([ahead], light, np.ones_like(light), [behind], Rules(), None)
    again = scene.averaged(behind)
    wrong = [part.views.any() or part.mean.any() or not np.isposinf(part.variance).all() for part in (found, again)]
    return float(any(wrong))


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


class Warped:
    """A matrix of weights with wrong squares."""

    def __init__(self, matrix: Any, squares: Callable[[Any], Any]) -> None:
        self.matrix, self.squares = matrix, squares

    def power(self, n: int) -> Any:
        return self.squares(self.matrix)

    def __matmul__(self, other: np.ndarray) -> np.ndarray:
        return np.asarray(self.matrix @ other)


@pytest.mark.parametrize(
    ("squares", "name"),
    [
        (lambda matrix: matrix, "exposures as good as each other"),
        (lambda matrix: matrix.power(2).toarray() + 1e-9, "variances from 1e-12 to 1e6"),
    ],
    ids=["weights instead of squares", "a little of every pixel"],
)
def test_wrong_variances_of_what_was_warped_are_noticed(
    fails: Fails, monkeypatch: pytest.MonkeyPatch, squares: Callable[[Any], Any], name: str
) -> None:
    def spoiled(*arguments: Any) -> tuple[Warped, np.ndarray]:
        matrix, seen = warp.warp(*arguments)
        return Warped(matrix, squares), seen

    monkeypatch.setattr(scene, "warp", spoiled)
    assert fails(name)


def test_lengths_that_have_a_unit_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    near = lambda expected, found, tolerance: np.abs(expected - found) <= tolerance  # noqa: E731
    monkeypatch.setattr(surface, "same_depth", near)
    monkeypatch.setattr(warp, "same_depth", near)
    assert fails("worlds from 1e-9 to 1e9 in size")


def test_planes_without_a_least_angle_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface, "GRAZING", 0.0)
    with np.errstate(all="ignore"):
        assert fails("a surface seen exactly from the side")


def test_dividing_by_the_weight_of_no_view_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def divided(*arguments: Any) -> scene.Average:
        found = average(*arguments)
        return scene.Average(found.mean * np.inf, found.variance, found.views)

    average = scene.average
    monkeypatch.setattr(HERE, "average", divided)
    with np.errstate(all="ignore"):
        assert fails("pixels that no exposure sees")
