from collections.abc import Callable

import pytest
import torch

from novags.splats.views import Views
from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.methods import consistency

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_a_nan_that_the_mask_only_multiplies_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    # Without its first line `reproject` itself cannot be tried: torch's grid_sample crashes on its way back from NaN.
    reproject = consistency.reproject

    def leaving(*arguments):
        warped, mask = reproject(*arguments)
        return torch.where(mask[..., None], warped, float("nan")), mask

    monkeypatch.setattr(consistency, "reproject", leaving)
    assert fails("depths of 0, below 0, infinite and NaN")


def test_a_logarithm_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.Tensor, "clamp_min", lambda self, low: self)
    assert fails("-log C at C from 0 to 1")


def test_positions_half_a_pixel_off_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = torch.nn.functional.grid_sample

    def corners(image, grid, **how):
        return sample(image, grid, **{**how, "align_corners": True})

    monkeypatch.setattr(torch.nn.functional, "grid_sample", corners)
    assert fails("grid sampling at pixel centres, half pixels and beyond the border")
    assert fails("one camera twice: pixels land on their own centres, up to the border")
    assert fails("projections onto the border and one pixel beyond it")


def test_a_mask_that_forgets_the_frame_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    reproject = consistency.reproject

    def everywhere(*arguments):
        warped, mask = reproject(*arguments)
        return warped, torch.ones_like(mask)

    monkeypatch.setattr(consistency, "reproject", everywhere)
    assert fails("opposite cameras, and cameras without overlap")


def test_an_extent_of_roundings_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def extent(self: Views) -> float:
        return 1.1 * float((self.centers - self.centers.mean(0)).norm(dim=-1).max()) or 1.0

    monkeypatch.setattr(Views, "extent", property(extent))
    assert fails("cameras that only turn have no partners and extent 1")
