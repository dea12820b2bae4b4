"""Hard cases of the spherical harmonics: poles, no direction, another degree, huge coefficients.

The reference takes Y_lm from mpmath's associated Legendre functions at 40 digits; its slopes are central differences
at a step of 1e-15.
"""

import itertools
import sys
from functools import lru_cache

import mpmath
import numpy as np
import pytest
import torch
from torch import Tensor

from novags.splats.cpu.parallel import run
from novags.splats.cpu.raster import harmonics
from novags.splats.cpu.raster.record import CHANNEL, ROW
from novags.splats.sh import sh_colors
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, relative_error, worse, worst_error

PART = Part("harmonics")
HERE = sys.modules[__name__]  # where the cases find what a test replaces

BOTH = ("torch", "numba", "gsplat")
# A colour is a sum of up to 17 terms, each a product of some five numbers.
COLORS = 20 * EPS
Array = np.ndarray
Exact = tuple[Array, Array, Array]


def _basis(direction: list[mpmath.mpf], degree: int) -> list[mpmath.mpf]:
    """Real Y_lm with the Condon-Shortley phase: sqrt(2) Im for m < 0, Re for m > 0."""
    length = mpmath.sqrt(sum(c * c for c in direction))
    if length == 0:
        return [mpmath.mpf(0)] * (degree + 1) ** 2
    x, y, z = (c / length for c in direction)
    polar, azimuth = mpmath.acos(z), mpmath.atan2(y, x) if x or y else mpmath.mpf(0)
    values = []
    for order in range(degree + 1):
        for m in range(-order, order + 1):
            value = mpmath.spherharm(order, abs(m), polar, azimuth)
            values.append(value.real if m == 0 else mpmath.sqrt(2) * (value.imag if m < 0 else value.real))
    return values


@lru_cache  # the settings of a case share it
def _exact(raw: bytes, n: int, degree: int) -> Exact:
    """Colours [N, 3], and the gradients of sum(weights * colours) in directions and coefficients.

    raw: Directions [N, 3], coefficients [N, 16, 3] and weights [N, 3], float64, one behind the other.
    """
    numbers = np.frombuffer(raw).reshape(-1)
    directions, weights = numbers[: 3 * n].reshape(n, 3), numbers[51 * n :].reshape(n, 3)
    sh = numbers[3 * n : 51 * n].reshape(n, 16, 3)
    k, step = (degree + 1) ** 2, mpmath.mpf(10) ** -15
    colors, v_directions, v_sh = np.zeros((len(sh), 3)), np.zeros((len(sh), 3)), np.zeros(sh.shape)
    with mpmath.workdps(40):
        for i, coefficients in enumerate(sh):
            place = [mpmath.mpf(float(c)) for c in directions[i]]
            basis = _basis(place, degree)
            terms = [mpmath.fsum(basis[j] * float(coefficients[j, c]) for j in range(k)) + 0.5 for c in range(3)]
            shown = [float(weights[i, c]) if terms[c] > 0 else 0.0 for c in range(3)]
            colors[i] = [max(0.0, float(t)) for t in terms]
            v_sh[i, :k] = [[float(b) * w for w in shown] for b in basis]
            slope = [mpmath.fsum(float(coefficients[j, c]) * shown[c] for c in range(3)) for j in range(k)]
            size = mpmath.sqrt(sum(c * c for c in place))
            for axis in range(3):
                moved = [[c + (s * step * size if a == axis else 0) for a, c in enumerate(place)] for s in (1, -1)]
                ends = [mpmath.fsum(map(mpmath.fmul, _basis(p, degree), slope)) for p in moved]
                v_directions[i, axis] = float((ends[0] - ends[1]) / (2 * step * size)) if size else 0.0
    return colors, v_directions, v_sh


def _computed(setting: Setting, directions: Array, sh: Array, weights: Array, degree: int) -> Exact:
    """The same in float32 by a backend: numba's kernels alone, or the formula that the others share."""
    if setting.backend == "numba":
        return _kernels(directions, sh, weights, degree)
    device = "cuda" if setting.backend == "gsplat" else "cpu"
    x, y = (torch.tensor(a, dtype=torch.float32, device=device).requires_grad_() for a in (directions, sh))
    colors = _shown(setting, degree, x, y)
    (colors * torch.tensor(weights, dtype=torch.float32, device=device)).sum().backward()
    assert y.grad is not None
    slopes = torch.zeros_like(x) if x.grad is None else x.grad  # degree 0 knows no direction
    return colors.detach().cpu().numpy(), slopes.cpu().numpy(), y.grad.cpu().numpy()


def _shown(setting: Setting, degree: int, directions: Tensor, sh: Tensor) -> Tensor:
    if setting.backend == "gsplat":
        from gsplat import spherical_harmonics

        return torch.clamp_min(spherical_harmonics(degree, directions, sh) + 0.5, 0.0)
    return sh_colors(degree, directions, sh)


def _kernels(directions: Array, sh: Array, weights: Array, degree: int) -> Exact:
    n = len(sh)
    means, flat = np.ascontiguousarray(directions, np.float32), np.ascontiguousarray(sh, np.float32).reshape(n, -1)
    center, zeros, suspect = np.zeros(3, np.float32), np.zeros(n, np.float32), np.zeros(1, np.int64)
    rows = np.zeros((n, ROW), np.float32)
    run(
        harmonics.forward, n, 16, degree, means, flat, center, zeros, np.float32(0), np.ones(n, np.int32), rows, suspect
    )
    v_means, v_sh = np.zeros((n, 3), np.float32), np.full(flat.shape, np.nan, np.float32)
    v_colors, none = np.ascontiguousarray(weights, np.float32), np.zeros((0, 3), np.float32)
    run(harmonics.backward, -(-n // 16), 1, 16, degree, means, flat, center, v_colors, v_sh, v_means, none)
    return rows[:, CHANNEL : CHANNEL + 3], v_means, v_sh.reshape(sh.shape)


def _random(n: int, *, size: float = 0.3) -> tuple[Array, Array]:
    """Coefficients [N, 16, 3] and weights [N, 3], rounded to float32."""
    rng = np.random.default_rng(0)
    sh, weights = size * rng.standard_normal((n, 16, 3)), rng.uniform(0.5, 1, (n, 3))
    return sh.astype(np.float32).astype(float), weights.astype(np.float32).astype(float)


def _error(setting: Setting, directions: Array, sh: Array, weights: Array, degree: int) -> float:
    directions = np.asarray(directions, np.float32).astype(float)
    found = _computed(setting, directions, sh, weights, degree)
    raw = np.concatenate([directions.ravel(), sh.ravel(), weights.ravel()]).tobytes()
    return worst_error(zip(found, _exact(raw, len(sh), degree), strict=True))


def _poles() -> Array:
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    beside = [[1e-4, 0, 1], [0, -1e-7, -1], [1e-12, 1e-12, 1], [0, 1, 1e-7]]
    return np.concatenate([axes, beside, [[1, 1, 1], [-1, 2, -0.5]]])


@PART.case("poles and directions near them", bound=COLORS, unit=LARGEST, backends=BOTH)
def poles(setting: Setting) -> float:
    """Where an azimuth is undefined; the polynomials know nothing of it."""
    directions = _poles()
    return max(_error(setting, directions, *_random(len(directions)), degree) for degree in (1, 3))


@PART.case("directions of length 1e-9 to 1e15", bound=COLORS, unit=LARGEST, backends=BOTH)
def any_length(setting: Setting) -> float:
    """Each by itself: a slope is as large as the direction is short."""
    sh, weights = _random(1)
    return max(_error(setting, np.array([[0.3, -0.8, 0.52]]) * 10.0**k, sh, weights, 3) for k in (-9, -5, 0, 6, 15))


@PART.case("a Gaussian at the camera's centre", bound=COLORS, unit=LARGEST, backends=("torch", "numba"))
def no_direction(setting: Setting) -> float:
    """Without a direction there is only the constant term; slopes are finite."""
    sh, weights = _random(20)
    colors, *slopes = _computed(setting, np.zeros((20, 3)), sh, weights, 3)
    y00 = float(mpmath.spherharm(0, 0, 0, 0).real)
    finite = all(np.isfinite(slope).all() for slope in slopes)
    return relative_error(colors, np.maximum(y00 * sh[:, 0] + 0.5, 0)) if finite else np.inf


@PART.case("another degree: what lies above it may be anything", bound=0, unit="of the colour", backends=BOTH)
def degree_switch(setting: Setting) -> float:
    """NaN above the degree in use changes no bit; zeros just above it neither, when they come into use."""
    directions, worst = _poles(), 0.0
    sh, weights = _random(len(directions))
    for degree in range(3):
        k, above = (degree + 1) ** 2, (degree + 2) ** 2
        zeros, nothing = sh.copy(), sh.copy()
        zeros[:, k:], nothing[:, k:] = 0, np.nan
        found = [
            _computed(setting, directions, *case)
            for case in ((zeros, weights, degree), (nothing, weights, degree), (zeros, weights, degree + 1))
        ]
        for a, b in itertools.combinations(found, 2):
            worst = max(worst, relative_error(a[0], b[0]))
        worst = worse(worst, relative_error(found[0][1], found[1][1]), float(np.abs(found[0][2][:, k:]).max()))
        worst = max(worst, relative_error(found[2][2][:, :k], found[0][2][:, :k]))
        assert np.abs(found[2][2][:, k:above]).max() > 0
    return worst


@PART.case("coefficients of 1e6", bound=COLORS, unit="of the largest term", backends=BOTH)
def huge_coefficients(setting: Setting) -> float:
    """Terms that cancel: the error is relative to the terms, not to what is left of them."""
    directions = _poles()
    sh, weights = _random(len(directions), size=1e6)
    return _error(setting, directions, sh, weights, 3)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_harmonics_from_angles_are_noticed_at_the_poles(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    colors = sh_colors

    def from_angles(degree, directions, sh):
        x, y, z = torch.nn.functional.normalize(directions, dim=-1).unbind(-1)
        polar, azimuth = torch.acos(z), torch.atan2(y, x)
        sine = torch.sin(polar)
        return colors(degree, torch.stack([sine * azimuth.cos(), sine * azimuth.sin(), polar.cos()], -1), sh)

    monkeypatch.setattr(HERE, "sh_colors", from_angles)
    assert fails("poles and directions near them")


def test_a_length_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    colors = sh_colors
    monkeypatch.setattr(HERE, "sh_colors", lambda d, x, sh: colors(d, x / x.norm(dim=-1, keepdim=True), sh))
    assert fails("a Gaussian at the camera's centre")


def test_half_precision_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    colors = sh_colors
    monkeypatch.setattr(HERE, "sh_colors", lambda d, x, sh: colors(d, x, sh.bfloat16().float()))
    for name in ("poles and directions near them", "directions of length 1e-9 to 1e15", "coefficients of 1e6"):
        assert fails(name), name


def test_coefficients_beyond_the_degree_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    colors = sh_colors
    monkeypatch.setattr(HERE, "sh_colors", lambda d, x, sh: colors(d, x, sh) + 0 * sh.sum((1, 2))[:, None])
    assert fails("another degree: what lies above it may be anything")


def test_the_reference_has_the_signs_of_3dgs() -> None:
    raw = np.concatenate([[0, 0, 2.0], np.eye(16)[2].repeat(3), np.ones(3)])
    color, _, v_sh = _exact(raw.tobytes(), 1, 3)
    assert color[0] == pytest.approx([0.5 + 0.4886025119029199] * 3, rel=1e-14)
    assert v_sh[0, 6, 0] == pytest.approx(2 * 0.31539156525252005, rel=1e-14)


def test_slopes_above_the_degree_that_are_left_as_they_were_are_noticed(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed = _computed

    def left(setting, directions, sh, weights, degree):
        colors, v_directions, v_sh = computed(setting, directions, sh, weights, degree)
        v_sh[:, (degree + 1) ** 2 :] = np.nan
        return colors, v_directions, v_sh

    monkeypatch.setattr(HERE, "_computed", left)
    assert fails("another degree: what lies above it may be anything")
