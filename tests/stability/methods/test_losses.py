"""Hard cases of the loss of the pictures (L1 and SSIM) and of the penalty on harmonics.

The references go window by window and Gaussian by Gaussian in numpy's float64; slopes of the first are central
differences of the loss, one value of the picture after the other.
"""

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from novags.methods.nova import sh_penalty as penalties
from novags.splats.training import losses
from novags.splats.training.step import harmonics_penalty
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, relative_error, worse, worst_error

PART = Part("losses")

C1, C2, WINDOW = 0.01**2, 0.03**2, 11
SHARE = 0.2  # of SSIM, as in 3DGS
# A variance is the difference of two means of squares of up to 1, rounded some four times, beside C2.
CANCELLED = 4 * EPS / C2
Array = np.ndarray


def _loss(x: Array, y: Array) -> float:
    """(1 - w) L1 + w (1 - SSIM) of pictures [H, W, C], spreads as sums of squares; outside counts as 0."""
    taps = np.exp(-0.5 * ((np.arange(WINDOW) - WINDOW // 2) / 1.5) ** 2)
    weights = np.outer(taps, taps) / taps.sum() ** 2
    pad = ((WINDOW // 2,) * 2, (WINDOW // 2,) * 2, (0, 0))
    a, b = (np.lib.stride_tricks.sliding_window_view(np.pad(p, pad), (WINDOW, WINDOW), (0, 1)) for p in (x, y))
    mx, my = ((weights * p).sum((-2, -1)) for p in (a, b))
    da, db = a - mx[..., None, None], b - my[..., None, None]
    spread, common = (weights * (da**2 + db**2)).sum((-2, -1)), (weights * da * db).sum((-2, -1))
    scores = (2 * mx * my + C1) * (2 * common + C2) / ((mx**2 + my**2 + C1) * (spread + C2))
    return float((1 - SHARE) * np.abs(x - y).mean() + SHARE * (1 - scores.mean()))


def _slopes(x: Array, y: Array) -> Array:
    found, step = np.empty_like(x), 1e-6
    for place in np.ndindex(x.shape):
        ends = []
        for sign in (-1, 1):
            moved = x.copy()
            moved[place] += sign * step
            ends.append(_loss(moved, y))
        found[place] = (ends[1] - ends[0]) / (2 * step)
    return found


def _picture_error(x: Array, y: Array) -> float:
    """Error of the loss, and of its slopes relative to the slope of L1."""
    exact = [a.astype(np.float32).astype(np.float64) for a in (x, y)]
    image = torch.tensor(exact[0], dtype=torch.float32, requires_grad=True)
    found = losses.photometric_loss(image, torch.tensor(exact[1], dtype=torch.float32), SHARE)
    found.backward()
    if image.grad is None or not torch.isfinite(image.grad).all():
        return math.inf
    largest = 1 / x.size
    slopes = np.abs(image.grad.double().numpy() - _slopes(*exact)).max() / largest
    return worse(abs(float(found.detach()) - _loss(*exact)), float(slopes))


def _textured(*shape: int) -> Array:
    return np.random.default_rng(0).uniform(0.02, 0.98, shape)


@PART.case("pictures: black, white, blank, equal, one bright pixel", bound=CANCELLED, unit="of L1's slope",
           backends=("numba",))  # fmt: skip
def blank_pictures(setting: Setting) -> float:
    """A blank window has no variance: C1 and C2 alone keep the score from 0 / 0."""
    shape = (13, 12, 1)
    lamp = np.zeros(shape)
    lamp[6, 7] = 1
    pictures = [np.zeros(shape), np.ones(shape), np.full(shape, 0.3), lamp]
    return worse(*(_picture_error(x, y) for x in pictures for y in pictures))


@PART.case("texture of one 8-bit step on a bright picture", bound=CANCELLED, unit="of L1's slope",
           backends=("numba",))  # fmt: skip
def faint_texture(setting: Setting) -> float:
    """Its variance is the difference of two means of squares that are a million times larger."""
    faint = 0.9 + _textured(13, 12, 1) / 255
    return worse(_picture_error(faint, faint[::-1]), _picture_error(faint, np.full(faint.shape, 0.9)))


@PART.case("pictures of one to nine pixels", bound=10 * EPS, unit="of L1's slope", backends=("numba",))
def small_pictures(setting: Setting) -> float:
    """The window of 11 pixels sees more of the outside than of them, so that no variance is small."""
    shapes = [(1, 1, 3), (1, 9, 3), (9, 1, 3), (2, 3, 3), (3, 3, 1)]
    return worse(*(_picture_error(_textured(*shape), 1 - _textured(*shape) ** 2) for shape in shapes))


def _penalty(sh: Array, places: Array, radii: Array, noise: Array) -> tuple[float, Array]:
    """Equation 16, Gaussian by Gaussian, and its slopes [N, K, 3]."""
    h, w = noise.shape
    value, slopes, seen = 0.0, np.zeros_like(sh), 0
    for k, (x, y) in enumerate(places):
        if not (radii[k] > 0 and 0 <= x <= w and 0 <= y <= h):
            continue
        seen += 1
        column, row = min(max(x - 0.5, 0), w - 1), min(max(y - 0.5, 0), h - 1)
        i, j = min(int(row), max(h - 2, 0)), min(int(column), max(w - 2, 0))
        v, u, i1, j1 = row - i, column - j, min(i + 1, h - 1), min(j + 1, w - 1)
        above = (1 - u) * noise[i, j] + u * noise[i, j1]
        weight = (1 - v) * above + v * ((1 - u) * noise[i1, j] + u * noise[i1, j1])
        value += weight * (sh[k, 1:] ** 2).sum()
        slopes[k, 1:] = 2 * weight * sh[k, 1:]
    return value / max(seen, 1), slopes / max(seen, 1)


def _penalty_error(sh: Array, places: Array, radii: Array, noise: Array) -> float:
    exact = [a.astype(np.float32).astype(np.float64) for a in (sh, places, radii, noise)]
    x, *others = (torch.tensor(a, dtype=torch.float32) for a in exact)
    x.requires_grad_()
    places, radii, noise = others
    found = harmonics_penalty(x, penalties.penalty_weights(places, radii > 0, noise))
    if found.requires_grad:
        found.backward()
    slopes = torch.zeros_like(x) if x.grad is None else x.grad
    value, wanted = _penalty(*exact)
    if value == 0:
        return worse(abs(float(found.detach())), float(slopes.abs().max()))
    return worst_error([(found, value), (slopes, wanted)])


@PART.case("harmonics of 1e-15 to 1e15, noise of 0 to 1, at borders and corners", bound=10 * EPS, unit=LARGEST)
def harmonics_at_the_border(setting: Setting) -> float:
    """A place of up to 9 pixels is rounded once, and noise changes by up to 1 within a pixel."""
    h, w = 5, 9
    noise = np.random.default_rng(1).uniform(0, 1, (h, w))
    noise[2] = 0
    places = np.array([[0, 0], [w, h], [0.5, 0.5], [w - 0.5, 0.25], [4.5, 2.5], [3.3, 1.7], [-1, 2], [4, h + 1]])
    radii = np.array([1, 2, 3, 1, 2, 0, 4, 5])
    sh = np.random.default_rng(2).normal(size=(len(places), 4, 3))
    return worse(*(_penalty_error(size * sh, places, radii, noise) for size in (1e-15, 1, 1e15)))


@PART.case("harmonics: nobody visible, degree 0, a picture of one pixel", bound=5 * EPS, unit=LARGEST)
def nothing_to_penalise(setting: Setting) -> float:
    """A mean over nobody is 0, not 0 / 0."""
    sh, places = _textured(3, 4, 3), np.full((3, 2), 0.5)
    noise, seen = np.full((1, 1), 0.25), np.ones(3)
    return worse(
        _penalty_error(sh, places, 0 * seen, noise),
        _penalty_error(sh, places + 7, seen, noise),
        _penalty_error(sh[:, :1], places, seen, noise),
        _penalty_error(sh, places, seen, noise),
        relative_error(penalties.noise_map(torch.zeros(2, 2, 3), torch.ones(2, 2, 3)), np.ones((2, 2))),
    )


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_a_score_without_its_constants_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def loss(image: Tensor, target: Tensor, share: float) -> Tensor:
        return (1 - share) * F.l1_loss(image, target) + share * (1 - losses.ssim(image, target))

    monkeypatch.setattr(losses, "photometric_loss", loss)
    assert not fails("pictures: black, white, blank, equal, one bright pixel")
    monkeypatch.setattr(losses, "C1", 0.0)
    monkeypatch.setattr(losses, "C2", 0.0)
    assert fails("pictures: black, white, blank, equal, one bright pixel")


def test_moments_of_half_the_digits_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = losses.photometric_loss
    monkeypatch.setattr(losses, "photometric_loss", lambda x, y, share: plain(x.bfloat16().float(), y, share))
    assert fails("texture of one 8-bit step on a bright picture")


def test_windows_that_mirror_the_border_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def blurred(images: Tensor) -> Tensor:
        weights = losses._kernel(images.dtype).outer(losses._kernel(images.dtype))[None, None]
        return F.conv2d(F.pad(images[:, None], (5, 5, 5, 5), mode="replicate"), weights)[:, 0]

    def loss(image: Tensor, target: Tensor, share: float) -> Tensor:
        return (1 - share) * F.l1_loss(image, target) + share * (1 - losses.ssim(image, target))

    monkeypatch.setattr(losses, "photometric_loss", loss)
    monkeypatch.setattr(losses, "_blur", blurred)
    assert fails("pictures of one to nine pixels")


def test_a_mean_over_nobody_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def weights(means2d: Tensor, visible: Tensor, noise: Tensor) -> Tensor:
        return torch.where(visible, penalties.noise_weights(noise, means2d), 0.0) / visible.sum()

    monkeypatch.setattr(penalties, "penalty_weights", weights)
    assert fails("harmonics: nobody visible, degree 0, a picture of one pixel")
    assert fails("harmonics of 1e-15 to 1e15, noise of 0 to 1, at borders and corners")


def test_noise_read_half_a_pixel_away_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = penalties.penalty_weights
    monkeypatch.setattr(penalties, "penalty_weights", lambda means, *others: plain(torch.sub(means, 0.5), *others))
    assert fails("harmonics of 1e-15 to 1e15, noise of 0 to 1, at borders and corners")
