"""How far an adapted network is followed: to where the error against the truth, which it does not see, is least."""

import numpy as np
import pytest
import torch

from novags.methods.denoised import blend as module
from novags.methods.denoised.blend import LEVELS, Blend, best_blend


def pixels(seed: int, count: int = 240_000) -> dict[str, torch.Tensor]:
    """Dark means and bright ones; the estimate before adaptation errs in the bright, the one after in the dark."""
    rng = np.random.default_rng(seed)
    mean = np.where(rng.random(count) < 0.5, rng.uniform(0.1, 1, count), rng.uniform(30, 150, count))
    variance = mean + 1
    dark = mean < 1
    before = mean + np.where(dark, 0.02, 0.4) * np.sqrt(variance) * rng.standard_normal(count)
    after = mean + np.where(dark, 0.4, 0.02) * np.sqrt(variance) * rng.standard_normal(count)
    second = mean + np.sqrt(5 * variance) * rng.standard_normal(count)
    found = {"mean": mean, "before": before, "after": after, "second": second, "variance": variance}
    return {name: torch.from_numpy(values).float() for name, values in found.items()}


def test_each_level_follows_the_estimate_that_is_right_there() -> None:
    p = pixels(0)
    blend = best_blend(p["before"], p["after"], p["second"], p["variance"])
    assert len(blend.levels) == LEVELS
    assert bool((blend.levels.diff() > 0).all())
    # 10,000 pixels a level: the standard error of a share is sqrt(5) / 0.4 / 100.
    assert blend.shares[blend.levels < 2].max() < 5 * 0.056
    assert blend.shares[blend.levels > 2].min() > 1 - 5 * 0.056
    fresh = pixels(1)
    both = [float(((fresh[name] - fresh["mean"]).square() / fresh["variance"]).mean()) for name in ("before", "after")]
    together = blend(fresh["before"], fresh["after"])
    assert float(((together - fresh["mean"]).square() / fresh["variance"]).mean()) < 0.3 * min(both)


@pytest.mark.parametrize(("errors", "share"), [((1.0, 1.0), 0.5), ((1.0, 2.0), 0.2), ((3.0, 1.0), 0.9)])
def test_independent_errors_are_weighted_by_inverse_variance(
    errors: tuple[float, float], share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors of standard deviations a and b: the best share of the second is a^2 / (a^2 + b^2)."""
    monkeypatch.setattr(module, "LEVELS", 1)
    rng = np.random.default_rng(2)
    count = 400_000
    before, after, second = (torch.from_numpy(50 + s * rng.standard_normal(count)) for s in (*errors, 7.0))
    found = best_blend(before, after, second, torch.ones(count))
    deviation = 7.0 / np.hypot(*errors) / np.sqrt(count)
    assert found.shares.tolist() == pytest.approx([share], abs=5 * deviation)


def test_an_adaptation_that_leads_away_from_the_data_is_not_followed_and_one_that_falls_short_is_followed_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "LEVELS", 1)
    before, after = torch.zeros(2), torch.ones(2)
    for second, share in ((-3.0, 0.0), (0.25, 0.25), (4.0, 1.0)):
        assert best_blend(before, after, torch.full((2,), second), torch.ones(2)).shares.tolist() == [share]


def test_pixels_of_one_level_count_by_the_inverse_of_their_variance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LEVELS", 1)
    before, after, second = torch.zeros(2), torch.tensor([1.0, 2.0]), torch.tensor([0.2, 1.8])
    found = best_blend(before, after, second, torch.tensor([1.0, 8.0]))
    assert found.shares.tolist() == pytest.approx([(0.2 / 1 + 2 * 1.8 / 8) / (1 / 1 + 4 / 8)])


def test_shares_are_interpolated_between_levels_and_held_beyond() -> None:
    blend = Blend(torch.tensor([1.0, 3.0, 4.0]), torch.tensor([0.0, 1.0, 0.5]))
    before = torch.tensor([[-2.0, 1.0, 2.0], [3.5, 4.0, 99.0]])
    expected = torch.tensor([[0.0, 0.0, 0.5], [0.75, 0.5, 0.5]])
    torch.testing.assert_close(blend(before, before + 10), before + 10 * expected)


def test_no_change_and_no_light_are_no_difficulty() -> None:
    zero = torch.zeros(100)
    found = best_blend(zero, zero, torch.randn(100, generator=torch.Generator().manual_seed(0)), zero + 1)
    assert len(found.levels) == 1
    torch.testing.assert_close(found(zero, zero), zero)


def test_a_level_that_comes_again_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of pixels that are all dark or all at white, several parts have one level."""
    monkeypatch.setattr(module, "LEVELS", 6)
    before = torch.tensor([1.0] * 30 + [5.0] * 30)
    found = best_blend(before, before + 1, before + 1, torch.ones(60))
    assert found.levels.tolist() == [1.0, 5.0]
    torch.testing.assert_close(found(before, before + 1), before + 1)
