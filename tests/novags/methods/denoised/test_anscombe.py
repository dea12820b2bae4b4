"""The transform against Monte Carlo and against its own definition."""

import numpy as np
import pytest
import torch

from novags.methods.denoised.anscombe import Anscombe

SAMPLES = 200_000


def noisy(mean: float, read_variance: float) -> torch.Tensor:
    rng = np.random.default_rng(int(100 * mean + read_variance))
    counts = rng.poisson(mean, SAMPLES) + rng.normal(0, np.sqrt(read_variance), SAMPLES)
    return torch.from_numpy(counts)


@pytest.mark.parametrize(("mean", "read_variance"), [(5, 0.16), (20, 0.16), (500, 0.16), (1, 16), (20, 16), (0, 400)])
def test_noise_of_any_camera_at_any_level_gets_a_variance_of_one(mean: float, read_variance: float) -> None:
    stabilised = Anscombe(torch.tensor(read_variance, dtype=torch.float64))
    # 7 %: what the transform itself leaves at few electrons; the scatter of the estimate is 0.3 %
    assert float(stabilised(noisy(mean, read_variance)).var()) == pytest.approx(1, abs=0.07)


def test_a_pixel_that_counts_nothing_keeps_its_read_noise_in_the_slope_at_black() -> None:
    found = float(Anscombe(torch.tensor(1.0, dtype=torch.float64))(noisy(0, 1.0)).var())
    root = np.sqrt(1.375)
    n = np.random.default_rng(5).normal(size=SAMPLES)
    slow = np.where(n > 0, 2 * (np.sqrt(np.maximum(n, 0) + 1.375) - root), n / root)
    assert found == pytest.approx(slow.var(), rel=0.02)
    assert found < 1


@pytest.mark.parametrize("read_variance", [0.0, 0.2, 16.0, 1e6])
def test_the_inverse_returns_every_value_exactly_black_and_below_included(read_variance: float) -> None:
    stabilised = Anscombe(torch.tensor(read_variance, dtype=torch.float64))
    values = torch.tensor([-50.0, -1.0, -1e-9, 0.0, 1e-9, 0.5, 3.0, 1e3, 1e6], dtype=torch.float64)
    torch.testing.assert_close(
        stabilised.inverse(stabilised(values)), values, rtol=1e-11, atol=1e-12 * (1 + read_variance)
    )


def test_it_increases_and_has_a_continuous_slope_through_black() -> None:
    stabilised = Anscombe(torch.tensor(0.3, dtype=torch.float64))
    electrons = torch.tensor([-1e-6, 0.0, 1e-6, -4.0, 9.0], dtype=torch.float64, requires_grad=True)
    stabilised(electrons).sum().backward()
    slope = electrons.grad
    assert slope is not None
    at_black = 1 / np.sqrt(0.3 + 3 / 8)
    # at 0 itself the two branches meet: either slope, not their sum
    np.testing.assert_allclose(slope[[0, 2, 3]].numpy(), at_black, rtol=1e-5)
    assert float(slope[4]) == pytest.approx(1 / np.sqrt(9.675))
    assert float(stabilised(torch.tensor(0.0, dtype=torch.float64))) == 0
