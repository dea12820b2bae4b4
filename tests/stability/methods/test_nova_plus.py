from collections.abc import Callable

import pytest
import torch

from novags.methods.nova_plus import merge
from novags.methods.tone import ToneCurve
from novags.testbed.stability import Case, Setting, measured

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_an_exponential_without_its_bound_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ToneCurve, "light", lambda self, tone: self.knee * torch.expm1(self.k * tone))
    monkeypatch.setattr(ToneCurve, "slope", lambda self, tone: self.knee * self.k * torch.exp(self.k * tone))
    assert fails("tones of -3 and of 20")


def test_opacities_without_their_bounds_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(merge, "INSIDE", (0.0, 1.0))
    assert fails("merged opacities of nearly 0 and nearly 1")


def test_light_that_is_nan_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ToneCurve, "light", lambda self, tone: tone * torch.nan)
    assert fails("a lamp a million times as bright as the median")
