import pytest
import torch
from torch import nn

from novags.methods.nova.resunet import InstanceNorm
from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.methods.denoiser import PART

CASES = {case.name: case for case in PART.cases}
HERE = Setting("torch", 1)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_normalised_rounding_noise_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(InstanceNorm, "forward", nn.InstanceNorm2d.forward)
    assert not measured(CASES["constant views: nothing for instance normalisation to divide by"], HERE).holds


def test_the_guard_of_constant_maps_changes_no_bit_of_others() -> None:
    x = torch.randn(2, 5, 7, 9, generator=torch.Generator().manual_seed(0))
    pair = [x.clone().requires_grad_() for _ in range(2)]
    found = [norm(y) for norm, y in zip((InstanceNorm(5), nn.InstanceNorm2d(5)), pair, strict=True)]
    for y in found:
        (y * torch.linspace(-1, 1, 9)).sum().backward()
    assert torch.equal(*found)
    assert torch.equal(pair[0].grad, pair[1].grad)


def test_a_wrong_slope_of_the_rectifier_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    leaky = nn.LeakyReLU.forward
    monkeypatch.setattr(nn.LeakyReLU, "forward", lambda self, x: leaky(self, x) * (1 + 1e-3))
    assert not measured(CASES["one electron"], HERE).holds
    assert not measured(CASES["one electron: five training steps"], HERE).holds
