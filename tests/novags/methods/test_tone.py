"""The curve between tones and light, and the response of a camera."""

import math

import numpy as np
import pytest
import torch

from novags.methods.tone import BRIGHTEST, KNEE, ResponseTable, ToneCurve, median_light, tone_curve

CURVE = ToneCurve(top=0.3, k=5.0)


def test_black_is_tone_0_and_top_is_tone_1() -> None:
    ends = CURVE.light(torch.tensor([0.0, 1.0], dtype=torch.float64))
    assert ends.tolist() == pytest.approx([0.0, 0.3], abs=1e-12)


def test_light_follows_the_equation() -> None:
    for r in (-0.2, 0.1, 0.55, 1.3):
        want = 0.3 * math.expm1(5 * r) / math.expm1(5)
        assert float(CURVE.light(torch.tensor(r, dtype=torch.float64))) == pytest.approx(want, rel=1e-12)


def test_the_slope_is_the_derivative() -> None:
    r = torch.linspace(-0.3, 1.4, 30, dtype=torch.float64)
    step = 1e-6
    numeric = (CURVE.light(r + step) - CURVE.light(r - step)) / (2 * step)
    torch.testing.assert_close(CURVE.slope(r), numeric, rtol=1e-7, atol=1e-10)


def test_tone_is_the_inverse_of_light_and_noise_far_below_black_stays_finite() -> None:
    r = torch.linspace(-0.15, 1.4, 30, dtype=torch.float64)
    torch.testing.assert_close(CURVE.tone(CURVE.light(r)), r, rtol=1e-9, atol=1e-9)
    below = CURVE.tone(torch.tensor([-10.0, -CURVE.knee]))
    assert float(below[0]) == float(below[1]) == pytest.approx(math.log(1e-3) / 5, rel=1e-3)


def test_the_knee_follows_the_median_and_the_top_the_brightest_pixels() -> None:
    light = torch.from_numpy(np.random.default_rng(0).lognormal(-3, 1.5, 50_001)).float()
    curve = tone_curve(light)
    assert curve.knee == pytest.approx(KNEE * float(light.median()), rel=1e-4)
    assert curve.top == pytest.approx(float(np.quantile(light.numpy(), BRIGHTEST)), rel=1e-4)
    lamp = light.clone()
    lamp[:60] = 100.0  # a lamp in view moves the top, not the knee
    assert tone_curve(lamp).top == 100.0
    assert tone_curve(lamp).knee == pytest.approx(curve.knee, rel=0.01)


def test_neighbours_are_those_in_a_row() -> None:
    rows = torch.tensor([[-1.0, -1.0, 5.0 + k, -1.0] for k in range(4)], dtype=torch.float64)  # means 0.5, 0.75, ...
    assert median_light(rows.flatten()) == 0.75  # torch's median is the lower one in the middle


def test_where_most_data_are_black_the_median_is_that_of_means_of_neighbours() -> None:
    """Rows of 0.05 to 0.15 electrons with read noise, in whole codes, and a lamp: the median of single data is 0."""
    rng = np.random.default_rng(1)
    light = np.repeat(rng.uniform(0.05, 0.15, 400), 256)
    codes = torch.from_numpy(np.round(rng.poisson(light) + 0.2 * rng.standard_normal(light.shape)))
    codes[:500] = 1000.0
    assert float(codes.median()) == 0
    found = tone_curve(codes.float())
    assert found.top == 1000
    assert 0.05 < found.knee / KNEE < 0.15


def test_pictures_without_light_are_refused() -> None:
    with pytest.raises(ValueError, match="median of the green pixels must be above black, got -0.2"):
        tone_curve(torch.full((100,), -0.2))


@pytest.mark.parametrize(("top", "k"), [(0.0, 1.0), (1.0, 0.0), (math.inf, 1.0), (1.0, math.nan)])
def test_a_curve_that_is_none_is_refused(top: float, k: float) -> None:
    with pytest.raises(ValueError, match="top and k must be > 0 and finite"):
        ToneCurve(top, k)


def test_a_response_is_straight_between_its_codes_and_keeps_the_outer_ones_beyond_them() -> None:
    table = ResponseTable(faint=0.5, low=-0.5, high=1.5, values=(0.1, 0.2, 0.7))
    logs = torch.tensor([-0.6, -0.5, 0.0, 0.5, 1.25, 1.5, 2.0], dtype=torch.float64)
    want = torch.tensor([0.1, 0.1, 0.15, 0.2, 0.575, 0.7, 0.7], dtype=torch.float64)
    torch.testing.assert_close(table.codes(logs.exp() - 0.5), want)
    darkest = table.codes(torch.tensor([-3.0, 0.0], dtype=torch.float64))  # negative radiance is black: ln 0.5
    assert darkest[0] == darkest[1]
