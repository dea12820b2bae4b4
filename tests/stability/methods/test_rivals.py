from collections.abc import Callable

import pytest
import torch

from novags.methods.rivals import luminance_gs, raw_gs
from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.methods import rivals

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_a_gradient_beyond_white_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def unbounded(self: raw_gs.RawLoss, step: object, target: torch.Tensor) -> torch.Tensor:
        render = step.render  # type: ignore[attr-defined]
        there = ~target.isnan()
        residual = torch.where(there, render - target, 0.0) / (render.detach() + self.epsilon)
        return residual.square().sum() / there.sum()

    monkeypatch.setattr(raw_gs.RawLoss, "__call__", unbounded)
    assert fails("raw-gs: renders at and beyond white, data missing")


def test_ratios_that_reach_0_and_1_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def plain(gamma: torch.Tensor, alpha: torch.Tensor, beta: torch.Tensor) -> torch.Tensor:
        x = torch.linspace(0, 1, rivals.BINS) ** gamma
        below = alpha - alpha * (1 - x / alpha) ** beta
        return torch.where(x <= alpha, below, alpha + (1 - alpha) * ((x - alpha) / (1 - alpha)) ** beta)

    monkeypatch.setattr(rivals, "power_then_s", plain)
    assert fails("luminance-gs: S-curves of every steepness, their slopes too")


def test_a_mean_of_0_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(luminance_gs, "DARKEST", 0.0)
    assert fails("luminance-gs: black, white and tiny pictures, loss and gradients")
