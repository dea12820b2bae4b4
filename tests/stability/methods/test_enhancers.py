from collections.abc import Callable

import numpy as np
import pytest
import torch

from novags.methods.enhancers.curves import drago, gain
from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.methods import enhancers

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_a_logarithm_over_its_argument_without_its_limit_is_noticed(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(np, "where", lambda condition, yes, no: yes)
    assert fails("tone curves: one bright pixel, a faint one, the rest black")


def test_a_log_average_in_which_black_ends_the_sum_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drago, "DARKEST", 1e-300)
    assert fails("tone curves: one bright pixel, a faint one, the rest black")


def test_a_gain_sought_in_too_small_a_range_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gain, "GAINS", (1.0, 1e3))
    assert fails("tone curves: 16-bit codes of 0 to 3 and of the whole range")


def test_a_bisection_that_stops_early_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gain, "STEPS", 12)
    assert fails("tone curves: pictures of one to nine pixels")


def test_slopes_of_two_precisions_are_compared() -> None:
    """They differ by roundings; equal ones would be those of one network compared with itself."""
    (case,) = [case for case in enhancers.PART.cases if case.name.startswith("losses without references")]
    assert measured(case, Setting("torch", 1)).error > 0


def test_a_root_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.Tensor, "clamp_min", lambda self, low: self)
    assert fails("losses without references: slopes on the same pictures")


def test_a_saturation_of_grey_that_is_raised_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "where", lambda condition, yes, no: yes)
    assert fails("adjustment of a result: black, white, grey, one bright pixel")


def test_a_curve_that_makes_nan_of_black_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    curve, last = enhancers._curve, enhancers.CURVES[-1]
    monkeypatch.setattr(enhancers, "_curve", lambda c, dark: curve(c, dark) * (np.nan if c is last else 1))
    assert fails("tone curves: all black")
