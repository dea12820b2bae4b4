from collections.abc import Callable

import pytest
import torch

from novags.fields.cpu import encode
from novags.methods.nerf import aleth
from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts import fields

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_a_difference_of_numbers_near_one_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def plain(log_density: torch.Tensor, widths: torch.Tensor) -> torch.Tensor:
        left = torch.exp(-torch.exp(log_density.clamp_max(15.0)) * widths)
        through = torch.cumprod(torch.cat([torch.ones_like(left[:, :1]), left[:, :-1]], 1), 1)
        return through * (1 - left)

    monkeypatch.setattr(fields, "weights_of", plain)
    assert fails("rays through almost nothing")


def test_a_density_without_a_limit_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def unlimited(log_density: torch.Tensor, widths: torch.Tensor) -> torch.Tensor:
        depth = torch.exp(1.2 * log_density) * widths
        return torch.exp(-(torch.cumsum(depth, 1) - depth)) * -torch.expm1(-depth)

    monkeypatch.setattr(fields, "weights_of", unlimited)
    assert fails("rays that are empty, or end in the first sample")


def test_a_tone_curve_without_ends_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aleth, "tone", lambda x: 0.5 - torch.sin(torch.asin(1 - 2 * x) / 3))
    assert fails("aleth-nerf: the tone curve at 0, 1 and beyond")


def test_levels_of_one_row_less_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    real = encode.forward

    def shifted(begin: int, end: int, positions: object, table: object, resolutions: object, *rest: object) -> None:
        real(begin, end, positions, table, resolutions - 1, *rest)  # type: ignore[operator]

    monkeypatch.setattr(encode, "forward", shifted)
    assert fails("positions on faces and corners of cells")


def test_transmittance_as_a_difference_of_sums_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def cancelling(log_density: torch.Tensor, widths: torch.Tensor) -> torch.Tensor:
        depth = torch.exp(log_density.clamp_max(15.0)) * widths
        return torch.exp(-(torch.cumsum(depth, 1) - depth)) * -torch.expm1(-depth)

    monkeypatch.setattr(fields, "weights_of", cancelling)
    assert fails("rays that are empty, or end in the first sample")
