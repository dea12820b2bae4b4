from collections.abc import Callable

import pytest
import torch
from torch import nn

from novags.methods.nova.resunet import InstanceNorm
from novags.testbed.stability import Case, Setting, measured

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_normalised_rounding_noise_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(InstanceNorm, "forward", nn.InstanceNorm2d.forward)
    assert fails("constant views: nothing for instance normalisation to divide by")


def test_the_guard_of_constant_maps_changes_no_bit_of_others() -> None:
    x = torch.randn(2, 5, 7, 9, generator=torch.Generator().manual_seed(0))
    pair = [x.clone().requires_grad_() for _ in range(2)]
    found = [norm(y) for norm, y in zip((InstanceNorm(5), nn.InstanceNorm2d(5)), pair, strict=True)]
    for y in found:
        (y * torch.linspace(-1, 1, 9)).sum().backward()
    assert torch.equal(*found)
    assert torch.equal(pair[0].grad, pair[1].grad)


def test_a_wrong_slope_of_the_rectifier_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    leaky = nn.LeakyReLU.forward
    monkeypatch.setattr(nn.LeakyReLU, "forward", lambda self, x: leaky(self, x) * (1 + 1e-3))
    assert fails("one electron")
    assert fails("one electron: five training steps")
