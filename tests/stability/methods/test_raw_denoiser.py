from collections.abc import Callable

import pytest
import torch

from novags.methods.denoised import measured as of_data
from novags.methods.denoised import recorrupted
from novags.methods.denoised.anscombe import Anscombe
from novags.testbed.stability import Case, Setting, measured

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_the_difference_of_two_roots_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def naive(self: Anscombe, electrons: torch.Tensor) -> torch.Tensor:
        floor = self.read_variance + 3 / 8
        return 2 * ((electrons + floor).clamp_min(1e-9).sqrt() - floor.sqrt())

    monkeypatch.setattr(Anscombe, "__call__", naive)
    assert fails("the transform at a millionth of an electron, read noise 0 to 1,000 e-")
    assert fails("there and back, at any read noise")


def test_data_cut_at_black_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    call = Anscombe.__call__
    monkeypatch.setattr(Anscombe, "__call__", lambda self, electrons: call(self, electrons.clamp_min(0)))
    assert fails("the transform far below black and at a million electrons")


def test_a_variance_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorrupted, "LEAST_VARIANCE", 0.0)
    assert fails("adaptation to frames without a single electron")


def test_noise_free_data_that_are_let_through_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of_data, "LacksInput", RuntimeError)
    assert fails("data without any noise")
