"""Hard cases of the geometric consistency: depths that are not numbers, cameras that share a place, confidence 0 and 1.

The reference works pixel by pixel in numpy's float64, with its own camera matrices; its gradients are central
differences of the loss, one pixel's depth after the other.
"""

import math
import sys

import numpy as np
import pytest
import torch

from novags.methods.nova.config import ConsistencyConfig
from novags.methods.nova.consistency import Pinhole, _sample, consistency_loss, reproject, source_candidates
from novags.splats.views import Views
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, relative_error, worst_error

PART = Part("consistency")
HERE = sys.modules[__name__]  # where the cases find what a test replaces

H, W, FOCAL = 9, 11, 10.0
# A projection takes some ten roundings of a pixel position of up to 11, and the picture changes by 1 within a pixel.
WARPED = 200 * EPS
Array = np.ndarray


def _camera(turn: float = 0.0, center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """World to camera, turned about y by `turn` radians."""
    view = np.eye(4)
    cosine, sine = math.cos(turn), math.sin(turn)
    view[:3, :3] = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    view[:3, 3] = -view[:3, :3] @ center
    return view


def _pinhole(view: Array, width: int = W, height: int = H, focal: float = FOCAL) -> Pinhole:
    K = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]
    return Pinhole(torch.tensor(view, dtype=torch.float32), torch.tensor(K, dtype=torch.float32))


def _bilinear(image: Array, x: float, y: float) -> Array:
    """Image [h, w, D] at one pixel position, borders repeated."""
    h, w = image.shape[:2]
    x, y = min(max(x - 0.5, 0), w - 1), min(max(y - 0.5, 0), h - 1)
    i, j = min(int(y), h - 2), min(int(x), w - 2)
    v, u = y - i, x - j
    upper = (1 - u) * image[i, j] + u * image[i, j + 1]
    return (1 - v) * upper + v * ((1 - u) * image[i + 1, j] + u * image[i + 1, j + 1])


def _warp(source: Array, depth: float, depths: Array, row: int, column: int, target: Array, other: Array) -> Array:
    """Colour that target pixel (row, column) at `depth` has in the source; NaN where the pixel does not count."""
    nothing = np.full(3, np.nan)
    if not (0 < depth < 1e10):
        return nothing
    ray = np.array([(column + 0.5 - W / 2) / FOCAL, (row + 0.5 - H / 2) / FOCAL, 1.0, 1 / depth])
    x, y, z = ((other @ np.linalg.inv(target)) @ ray)[:3]
    if z <= 0:
        return nothing
    px, py = FOCAL * x / z + W / 2, FOCAL * y / z + H / 2
    if not (0.499 < px < W - 0.499 and 0.499 < py < H - 0.499):
        return nothing
    seen = float(_bilinear(depths[..., None], px, py)[0])
    if not (0 < seen < math.inf):
        return nothing
    back = target @ np.linalg.inv(other) @ [(px - W / 2) / FOCAL * seen, (py - H / 2) / FOCAL * seen, seen, 1]
    return _bilinear(source, px, py) if abs(depth - back[2]) < 0.1 * back[2] else nothing


def _loss(warped: Array, target: Array, confidence: Array, weight: float) -> float:
    valid = np.isfinite(warped[..., 0])
    terms = confidence * np.abs(target - warped).mean(-1) - weight * np.log(np.maximum(confidence, 1e-7))
    return float(terms[valid].sum() / max(1, valid.sum()))


def _error(depth_t: Array, depth_s: Array, view_t: Array, view_s: Array) -> float:
    """Error of the mask, the warped picture where it counts, the loss, and its gradient in the target depth."""
    rng = np.random.default_rng(0)
    source, target, confidence = rng.random((H, W, 3)), rng.random((H, W, 3)), rng.random((H, W))
    x = torch.tensor(depth_t, dtype=torch.float32, requires_grad=True)
    arrays = (torch.tensor(a, dtype=torch.float32) for a in (source, target, confidence))
    source32, target32, confidence32 = arrays
    depths = torch.tensor(depth_s, dtype=torch.float32)
    warped, mask = reproject(source32, x, depths, _pinhole(view_t), _pinhole(view_s))
    loss = consistency_loss(warped, target32, confidence32, mask, 0.05)
    loss.backward()

    def pixel(i: int, j: int, depth: float) -> Array:
        return _warp(source, depth, depth_s, i, j, view_t, view_s)

    exact = np.array([[pixel(i, j, depth_t[i, j]) for j in range(W)] for i in range(H)])
    valid = np.isfinite(exact[..., 0])
    if not np.array_equal(valid, mask.numpy()) or x.grad is None:
        return math.inf
    slope = np.zeros((H, W))
    for i, j in zip(*np.nonzero(valid), strict=True):
        step = 1e-6 * depth_t[i, j]
        ends = [np.abs(target[i, j] - pixel(i, j, depth_t[i, j] + s)).mean() for s in (-step, step)]
        slope[i, j] = confidence[i, j] * (ends[1] - ends[0]) / (2 * step) / max(1, valid.sum())
    if not np.isfinite(slope).all():
        raise AssertionError("a central difference left the valid pixels: the case is too close to a threshold")
    return worst_error(
        [(warped[mask], exact[valid]), (loss, _loss(exact, target, confidence, 0.05)), (x.grad, slope)]
        if valid.any() else [(loss, 0.0), (x.grad, slope)]
    )  # fmt: skip


def _depths() -> Array:
    """Depths of a wavy wall, none of whose pixels falls on a threshold."""
    y, x = np.mgrid[:H, :W]
    return 3 + 0.13 * np.sin(x + 0.5 * y)


@PART.case("depths of 0, below 0, infinite and NaN", bound=WARPED, unit=LARGEST)
def no_depths(setting: Setting) -> float:
    """In the target and in the source; no such pixel counts, and none leaves a NaN."""
    depth_t, depth_s = _depths(), _depths()
    depth_t[0, :9] = [0, -1, np.inf, -np.inf, np.nan, 1e-30, 1e30, 3e38, -1e-30]
    for (i, j), value in {(3, 2): 0, (3, 8): -2, (6, 2): np.inf, (6, 8): np.nan}.items():
        depth_s[i, j] = value
    return _error(depth_t, depth_s, _camera(), _camera(0.02, (0.13, 0.02, 0.03)))


@PART.case("one camera twice: pixels land on their own centres, up to the border", bound=5e-3, unit=LARGEST)
def identical_cameras(setting: Setting) -> float:
    """At 8,000 pixels one rounding of a position is half a thousandth of a pixel; noise changes by 1 in a pixel."""
    worst = 0.0
    for width in (11, 640, 8000):
        camera = _pinhole(_camera(0.7, (0.3, -0.2, 1.1)), width=width, height=2, focal=0.8 * width)
        image = torch.rand(2, width, 3, generator=torch.Generator().manual_seed(0))
        depth = torch.full((2, width), 2.3)
        warped, mask = reproject(image, depth, depth, camera, camera)
        worst = max(worst, relative_error(warped, image), math.inf if not mask.all() else 0)
    return worst


@PART.case("projections onto the border and one pixel beyond it", bound=WARPED, unit=LARGEST)
def onto_the_border(setting: Setting) -> float:
    """A sideways step by whole pixels: columns land on the first or last centre, or just outside."""
    depth = np.full((H, W), 2.5)
    worst = 0.0
    for pixels in (1.004, -1.004, 3.996, 9.996, -10.004):
        worst = max(worst, _error(depth, depth, _camera(), _camera(0.0, (pixels * 2.5 / FOCAL, 0, 0))))
    return worst


@PART.case("opposite cameras, and cameras without overlap", bound=WARPED, unit=LARGEST)
def no_overlap(setting: Setting) -> float:
    """No pixel counts: loss and gradients are 0. And two that face each other across a wall, whose depths agree."""
    depth = _depths()
    apart = [_camera(math.pi), _camera(1.6, (2, 0, 1)), _camera(0.0, (0, 0, 6)), _camera(0.0, (50, 0, 0))]
    worst = max(_error(depth, depth, _camera(), view) for view in apart)
    facing = _camera(math.pi, (0.11, 0.07, 6.0))
    return max(worst, _error(np.full((H, W), 3.0), np.full((H, W), 3.0), _camera(), facing))


@PART.case("-log C at C from 0 to 1", bound=20 * EPS, unit=LARGEST)
def confidence(setting: Setting) -> float:
    """Logits of +-100 and between: sigmoids underflow to 0 and round to 1. The floor is 1e-7, with no slope below."""
    logits = torch.tensor([-100.0, -87, -50, -17, -16, -8, 0, 8, 15, 17, 50, 100]).reshape(1, -1)
    residual = torch.linspace(0, 1, 12).reshape(1, -1, 1).expand(-1, -1, 3)
    x = logits.clone().requires_grad_()
    mask = torch.ones(1, 12, dtype=torch.bool)
    found = consistency_loss(residual, torch.zeros(1, 12, 3), torch.sigmoid(x), mask, 0.05)
    found.backward()
    z = logits.double().numpy()
    c = 1 / (1 + np.exp(-z))
    r = residual[..., 0].double().numpy()
    wanted = (c * r - 0.05 * np.log(np.maximum(c, 1e-7))).sum() / 12
    slope = (c * (1 - c) * r - np.where(c > 1e-7, 0.05 * (1 - c), 0)) / 12
    return worst_error([(found, wanted), (x.grad, slope)])


@PART.case("grid sampling at pixel centres, half pixels and beyond the border", bound=20 * EPS * W, unit=LARGEST)
def half_pixels(setting: Setting) -> float:
    """Values everywhere; slopes at half pixels, between four centres. Twenty roundings of a position of up to W."""
    rng = np.random.default_rng(1)
    image = rng.random((H, W, 3))
    halves = np.stack(np.meshgrid(np.arange(-2, 2 * W + 3) / 2, np.arange(-2, 2 * H + 3) / 2), -1)
    exact = np.array([[_bilinear(image, x, y) for x, y in row] for row in halves])
    x = torch.tensor(halves, dtype=torch.float32, requires_grad=True)
    found = _sample(torch.tensor(image, dtype=torch.float32), x)
    found.sum().backward()
    inner = (halves % 1 == 0).all(-1) & (halves > 0).all(-1) & (halves < [W, H]).all(-1)
    columns, rows = halves[inner].astype(int).T
    a, b = image[rows - 1, columns - 1].sum(-1), image[rows - 1, columns].sum(-1)
    c, d = image[rows, columns - 1].sum(-1), image[rows, columns].sum(-1)
    slope = np.stack([(b - a + d - c) / 2, (c - a + d - b) / 2], -1)
    assert x.grad is not None
    return worst_error([(found, exact), (x.grad[torch.from_numpy(inner)], slope)])


@PART.case("cameras that only turn have no partners and extent 1", bound=0, unit="wrong partners")
def turning_on_the_spot(setting: Setting) -> float:
    """Their centres differ by rounding alone. And with one that moved, only that one is a partner."""
    wrong = 0
    for count in (2, 8, 40):
        views = [_camera(0.01 * i, (0.37, 1.1, -2.3)) for i in range(count)]
        moved = [*views, _camera(0.0, (0.57, 1.1, -2.3))]
        for cameras, partners in ((views, 0), (moved, 1)):
            tensor = torch.tensor(np.stack(cameras), dtype=torch.float32)
            made = Views(tensor, torch.eye(3).repeat(len(tensor), 1, 1), W, H)
            found = source_candidates(made, ConsistencyConfig(neighbours=50))
            wrong += sum(abs(len(found[i]) - partners) for i in range(count) if abs(0.01 * i) < 0.5)
            wrong += int(partners == 0 and made.extent != 1)
    return float(wrong)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_a_nan_that_the_mask_only_multiplies_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    # Without its first line `reproject` itself cannot be tried: torch's grid_sample crashes on its way back from NaN.
    plain = reproject

    def leaving(*arguments):
        warped, mask = plain(*arguments)
        return torch.where(mask[..., None], warped, float("nan")), mask

    monkeypatch.setattr(HERE, "reproject", leaving)
    assert fails("depths of 0, below 0, infinite and NaN")


def test_a_logarithm_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.Tensor, "clamp_min", lambda self, low: self)
    assert fails("-log C at C from 0 to 1")


def test_positions_half_a_pixel_off_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = torch.nn.functional.grid_sample

    def corners(image, grid, **how):
        return sample(image, grid, **{**how, "align_corners": True})

    monkeypatch.setattr(torch.nn.functional, "grid_sample", corners)
    assert fails("grid sampling at pixel centres, half pixels and beyond the border")
    assert fails("one camera twice: pixels land on their own centres, up to the border")
    assert fails("projections onto the border and one pixel beyond it")


def test_a_mask_that_forgets_the_frame_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = reproject

    def everywhere(*arguments):
        warped, mask = plain(*arguments)
        return warped, torch.ones_like(mask)

    monkeypatch.setattr(HERE, "reproject", everywhere)
    assert fails("opposite cameras, and cameras without overlap")


def test_an_extent_of_roundings_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def extent(self: Views) -> float:
        return 1.1 * float((self.centers - self.centers.mean(0)).norm(dim=-1).max()) or 1.0

    monkeypatch.setattr(Views, "extent", property(extent))
    assert fails("cameras that only turn have no partners and extent 1")
