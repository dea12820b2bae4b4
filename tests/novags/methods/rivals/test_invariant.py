"""The illumination-invariant structure: against analytic pictures, a slow version, and under other light."""

import math

import numpy as np
import pytest
import torch

from novags.methods.rivals.invariant import invariant, structure

PAINT = np.array([0.5, 0.3, 0.2])
# Geusebroek et al. 2001: E, E_l and E_ll of red, green and blue
COLOUR_MODEL = np.array([[0.06, 0.63, 0.27], [0.30, 0.04, -0.35], [0.34, -0.60, 0.17]])


def slowly(light: np.ndarray, scale: float) -> np.ndarray:
    """W by its definition: float64, pixel by pixel, every filter as a sum over a window."""
    height, width = light.shape[:2]
    spectral = light @ COLOUR_MODEL.T
    reach = math.ceil(4 * scale)
    offsets = np.arange(-reach, reach + 1)
    smooth = np.exp(-0.5 * (offsets / scale) ** 2)
    slope = offsets * smooth
    smooth, slope = smooth / smooth.sum(), slope / (slope * offsets).sum()

    def at(y: int, x: int, down: np.ndarray, across: np.ndarray) -> np.ndarray:
        total = np.zeros(3)
        for dy, a in zip(offsets, down, strict=True):
            for dx, b in zip(offsets, across, strict=True):
                total += a * b * spectral[min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)]
        return total

    found = np.zeros((height, width))
    for y in range(height):
        for x in range(width):
            strength = at(y, x, smooth, smooth)[0]
            slopes = np.concatenate([at(y, x, smooth, slope), at(y, x, slope, smooth)])
            found[y, x] = np.sqrt(((slopes / strength) ** 2).sum())
    return found


@pytest.mark.parametrize("scale", [0.7, 1.0, 1.5])
def test_it_is_what_its_definition_says(scale: float) -> None:
    light = np.random.default_rng(1).uniform(0.1, 1, (9, 12, 3))
    np.testing.assert_allclose(invariant(torch.tensor(light), scale).numpy(), slowly(light, scale), rtol=1e-9)


def test_one_paint_in_light_that_falls_off_has_the_slope_of_its_logarithm_times_its_colour() -> None:
    """Under a Gaussian an exponential keeps its logarithmic slope, but for the sampling of its derivative."""
    y, x = np.mgrid[:40, :40]
    light = np.exp(0.02 * x - 0.03 * y)[..., None] * PAINT
    spectral = COLOUR_MODEL @ PAINT
    want = math.hypot(0.02, 0.03) * np.linalg.norm(spectral / spectral[0])
    found = invariant(torch.tensor(light)).numpy()[8:-8, 8:-8]
    np.testing.assert_allclose(found, want, rtol=1e-3)


def test_the_strength_of_the_light_changes_nothing() -> None:
    light = torch.tensor(np.random.default_rng(2).uniform(0.05, 1, (16, 16, 3)))
    torch.testing.assert_close(invariant(0.003 * light), invariant(light))
    torch.testing.assert_close(structure(0.003 * light), structure(light))


def test_an_edge_of_paint_stands_out_as_much_in_the_dark_half_as_in_the_bright_one() -> None:
    light = np.full((32, 40, 3), 1.0) * PAINT
    light[:, 20:] *= 0.5  # another paint
    light[16:] *= 0.01  # the lower half lies in the dark
    found = invariant(torch.tensor(light)).numpy()
    assert found[24, 20] == pytest.approx(found[8, 20], rel=1e-6)
    assert found[8, 20] > 100 * found[8, 8]


def test_structure_is_a_half_where_the_invariant_is_its_median() -> None:
    light = torch.tensor(np.random.default_rng(3).uniform(0.05, 1, (15, 15, 3)))
    found, ratios = structure(light), invariant(light)
    torch.testing.assert_close(found, ratios / (ratios + ratios.median()))
    assert float(found.median()) == pytest.approx(0.5)


def test_black_pictures_have_no_structure() -> None:
    assert not bool(structure(torch.zeros(8, 9, 3)).any())
    spot = torch.zeros(21, 21, 3)
    spot[10, 10] = 1.0
    found = structure(spot)
    assert bool(((found >= 0) & (found <= 1)).all())
    assert float(found[10, 8]) > 0.5
