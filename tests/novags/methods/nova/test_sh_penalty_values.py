"""The harmonics' penalty against a loop over Gaussians and colours."""

import numpy as np
import pytest
import torch

from novags.methods.nova.sh_penalty import noise_map, noise_weights, penalty_weights
from novags.splats.training.step import harmonics_penalty

HEIGHT, WIDTH = 5, 8


def sh_penalty(sh: torch.Tensor, means2d: torch.Tensor, radii: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
    """L_SH; radii are 0 where a Gaussian is not visible."""
    return harmonics_penalty(sh, penalty_weights(means2d, radii > 0, noise))


def noise() -> torch.Tensor:
    return torch.rand(HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def bilinear(plane: np.ndarray, x: float, y: float) -> float:
    """Value between pixel centres at +0.5, the border repeated."""
    u, v = np.clip(x - 0.5, 0, plane.shape[1] - 1), np.clip(y - 0.5, 0, plane.shape[0] - 1)
    left, top = int(u), int(v)
    right, below = min(left + 1, plane.shape[1] - 1), min(top + 1, plane.shape[0] - 1)
    upper = plane[top, left] * (1 - (u - left)) + plane[top, right] * (u - left)
    lower = plane[below, left] * (1 - (u - left)) + plane[below, right] * (u - left)
    return upper * (1 - (v - top)) + lower * (v - top)


def test_the_noise_map_is_the_mean_over_colours_of_each_view():
    generator = torch.Generator().manual_seed(1)
    enhanced, denoised = torch.rand(2, 2, 3, 4, 3, generator=generator)
    found = noise_map(enhanced, denoised)
    for view, y, x in np.ndindex(2, 3, 4):
        difference = [abs(float(enhanced[view, y, x, c] - denoised[view, y, x, c])) for c in range(3)]
        assert float(found[view, y, x]) == pytest.approx(sum(difference) / 3, rel=1e-5)


def test_weights_are_read_at_x_y_with_the_border_repeated():
    rng = np.random.default_rng(0)
    centres = rng.uniform((-1, -1), (WIDTH + 1, HEIGHT + 1), (60, 2))
    expected = [bilinear(noise().numpy(), x, y) for x, y in centres]
    np.testing.assert_allclose(noise_weights(noise(), torch.from_numpy(centres)), expected, rtol=1e-9)


def test_the_penalty_is_the_mean_over_visible_gaussians_inside_the_frame():
    rng = np.random.default_rng(0)
    centres = rng.uniform((-2, -2), (WIDTH + 2, HEIGHT + 2), (40, 2))
    radii = rng.integers(0, 3, 40)
    sh = rng.normal(size=(40, 9, 3))
    total, count = 0.0, 0
    for (x, y), radius, coefficients in zip(centres, radii, sh, strict=True):
        if radius > 0 and 0 <= x <= WIDTH and 0 <= y <= HEIGHT:
            squares = sum(float(coefficients[k, c]) ** 2 for k in range(1, 9) for c in range(3))
            total += bilinear(noise().numpy(), x, y) * squares
            count += 1
    assert 5 < count < 40
    found = sh_penalty(torch.from_numpy(sh), torch.from_numpy(centres), torch.from_numpy(radii), noise())
    assert float(found) == pytest.approx(total / count, rel=1e-9)


@pytest.mark.parametrize(
    ("centre", "counts"),
    [((0.0, 0.0), True), ((WIDTH, HEIGHT), True), ((WIDTH + 0.1, 1), False), ((1, HEIGHT + 0.1), False),
     ((-0.1, 1), False), ((1, -0.1), False), ((HEIGHT + 1, 1), True)],
)  # fmt: skip
def test_a_centre_counts_up_to_the_edge_of_the_frame(centre, counts):
    sh = torch.ones(1, 4, 3, dtype=torch.float64)
    found = sh_penalty(sh, torch.tensor([centre], dtype=torch.float64), torch.tensor([1]), noise())
    assert (float(found) > 0) == counts


def test_the_penalty_grows_with_the_noise_under_a_gaussian():
    quiet, loud = torch.full((HEIGHT, WIDTH), 0.1), torch.full((HEIGHT, WIDTH), 0.3)
    arguments = torch.full((1, 4, 3), 2.0), torch.tensor([[3.0, 2.0]]), torch.tensor([1])
    # 9 coefficients of 2² each
    assert float(sh_penalty(*arguments, quiet)) == pytest.approx(0.1 * 36)
    assert float(sh_penalty(*arguments, loud)) == pytest.approx(0.3 * 36)


def test_the_kernel_gives_the_weights_of_torch():
    """Gaussians that are not visible may be anywhere, or nowhere."""
    g = torch.Generator().manual_seed(4)
    centres = torch.rand(500, 2, generator=g) * torch.tensor([WIDTH + 4.0, HEIGHT + 4.0]) - 2
    centres[:4] = torch.tensor([[0.0, 0.0], [WIDTH, HEIGHT], [torch.nan, 1.0], [torch.inf, 1.0]])
    visible = torch.rand(500, generator=g) < 0.7
    visible[:4] = torch.tensor([True, True, False, False])
    kernel = penalty_weights(centres, visible, noise().float())
    plain = penalty_weights(centres.double(), visible, noise())
    assert 0.2 < float((plain > 0).float().mean()) < 0.6
    torch.testing.assert_close(kernel.double(), plain, rtol=2e-5, atol=1e-9)
