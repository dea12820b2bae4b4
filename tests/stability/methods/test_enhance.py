from collections.abc import Callable

import pytest
import torch

from novags.methods.enhancers import guided
from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.methods import enhance as cases

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_a_variance_in_float32_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def in_float32(image, radius, epsilon):
        mean = guided.box_mean(image, radius)
        variance = guided.box_mean(image * image, radius) - mean * mean
        a = variance / (variance + epsilon.reshape(-1, 1, 1, 1).clamp_min(1e-14).to(image.dtype))
        return guided.box_mean(a, radius) * image + guided.box_mean(mean * (1 - a), radius)

    monkeypatch.setattr(guided, "guided_filter", in_float32)
    assert fails("texture of one 16-bit step on a bright picture")


def test_a_ratio_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.Tensor, "clamp_min", lambda self, low: self)
    assert fails("all black")
    assert fails("one bright pixel, the rest black")


def test_a_gamma_that_stops_early_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    solve = guided.solve_gamma
    monkeypatch.setattr(guided, "solve_gamma", lambda brightness, config: solve(brightness, config) * (1 + 1e-4))
    for name in ("codes 0 to 3 of 65535", "a picture brighter than the target", "constant images of 16-bit levels"):
        assert fails(name), name


def test_a_check_that_lets_nan_through_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guided, "check_picture", lambda dark: None)
    assert fails("a pixel that is NaN, infinite, negative or above 1")


def test_a_curve_without_its_straight_foot_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "where", lambda condition, yes, no: no)
    assert fails("known noise of constant pictures from black to white")


def test_a_ratio_without_its_floors_is_noticed_in_the_noise_of_nothing(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.Tensor, "clamp_min", lambda self, low: self)
    assert fails("noise of pictures that are black, white, of one code or of two")


def test_moments_of_clipped_values_taken_for_those_before_are_noticed(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = cases._before_8_bits
    monkeypatch.setattr(cases, "_before_8_bits", lambda mean, variance: (mean, variance))
    assert fails("a normal before it was clipped at black, its mean from -0.9 to 5.9 deviations")
    monkeypatch.setattr(
        cases, "_before_8_bits", lambda mean, variance: (before(mean, variance)[0], variance * torch.nan)
    )
    assert fails("a normal before it was clipped at black, its mean from -0.9 to 5.9 deviations")
