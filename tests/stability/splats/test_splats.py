from collections.abc import Callable

import mpmath
import pytest
import torch

from novags.splats.raster import raster_numba, raster_torch
from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.splats.dense import render
from novags.testbed.stability.parts.splats.rasterizer import SMALL, _single

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_a_conic_that_cancels_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    # in float32 the readable rasteriser, which inverts the covariance, is what the kernels must not be
    monkeypatch.setattr(raster_numba, "render", raster_torch.render)
    assert fails("needles: near-singular covariances", "numba")


def test_squares_of_short_quaternions_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raster_torch, "unit_largest", lambda quats: quats)
    assert fails("quaternions of length 1e-20, 1e20 and subnormal", "torch")


def test_layers_in_half_precision_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    composite = raster_torch.composite

    def coarse(means2d, covs2d, opacities, *others):
        return composite(means2d, covs2d, opacities.bfloat16().float(), *others)

    monkeypatch.setattr(raster_torch, "composite", coarse)
    for name in ("100,000 layers", "logits -100 to 100", "one ordinary scene, for comparison"):
        assert fails(name, "torch"), name


def test_a_slope_through_the_cap_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def leaking(x, largest):
        return x + (torch.minimum(x, torch.tensor(largest)) - x).detach()

    monkeypatch.setattr(torch, "clamp_max", leaking)
    assert fails("logits -100 to 100", "torch")


def test_dust_without_the_added_variance_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    dilated = raster_torch.dilated
    monkeypatch.setattr(raster_torch, "dilated", lambda M, eps2d: dilated(M, 0.2))
    assert fails("log scales -40 to 20", "torch")


def test_the_reference_equals_one_splat_at_fifty_digits() -> None:
    scene = _single(quats=[1.0, 0, 0, 0], scales=[100.0, 1e-3, 1e-3], means=[0.1, -0.05, 4.0])
    image, alpha = render(**scene, camera=SMALL)
    with mpmath.workdps(50):
        x, y, z, f = (mpmath.mpf(float(v)) for v in (*scene["means"][0], SMALL.focal))
        sx, sy, sz = (mpmath.mpf(float(v)) for v in scene["scales"][0])
        J = mpmath.matrix([[f / z, 0, -f * x / z**2], [0, f / z, -f * y / z**2]])
        S = mpmath.diag([sx**2, sy**2, sz**2])
        conic = (J * S * J.T + mpmath.mpf("0.3") * mpmath.eye(2)) ** -1
        d = mpmath.matrix([14.5 - f * x / z - SMALL.width / 2, 8.5 - f * y / z - SMALL.height / 2])
        expected = mpmath.mpf(float(scene["opacities"][0])) * mpmath.exp(-(d.T * conic * d)[0] / 2)
    assert float(alpha[8, 14]) == pytest.approx(float(expected), rel=1e-12)
    assert image[8, 14].tolist() == pytest.approx([float(expected * c) for c in scene["colors"][0].tolist()], rel=1e-12)
