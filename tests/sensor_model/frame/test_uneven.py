"""Views that were not taken alike: what a factor does to light and noise, how it is undone, and the mean of a burst."""

from typing import Any

import numpy as np
import pytest

from sensor_model import PRESETS, Exposure, Sensor, develop, develop_linear, expose, expose_burst, from_linear16
from sensor_model.capture import mean_of
from sensor_model.frame.uneven import EVEN, Uneven, draw_uneven
from sensor_model.isp import white_balance
from sensor_model.noise import linear_noise, raw_noise

TIME = Exposure(time=1 / 30)
NONE: dict[str, Any] = {"exposure_spread": 0.0, "white_balance_spread": 0.0, "bracket": 0.0}
NOISY = Sensor(
    gain=2.0, eta=0.6, mu_e_sat=6000, black_level=200, bits=14, sigma_d=3.0, sigma_row=0.5, dsnu=1.5, prnu=0.02,
    dark_current=30.0, cfa=None,
)  # fmt: skip


def factors(seed: int = 0, views: int = 4000, sensor: Sensor = NOISY, **how: float) -> Uneven:
    return draw_uneven(sensor, views, seed=seed, **{**NONE, **how})


def test_exposures_are_even_in_stops_up_to_the_spread_and_belong_to_seed_and_view() -> None:
    stops = np.log2(factors(exposure_spread=1.5).exposures)
    assert np.abs(stops).max() <= 1.5
    shares, _ = np.histogram(stops, 6, (-1.5, 1.5))
    assert np.abs(shares - 4000 / 6).max() < 5 * np.sqrt(4000 * 5 / 36)
    assert factors(views=7, exposure_spread=1.5).exposures == factors(exposure_spread=1.5).exposures[:7]
    assert factors(seed=1, views=7, exposure_spread=1.5) != factors(views=7, exposure_spread=1.5)


def test_one_kind_changes_no_draw_of_another_and_tells_nothing_of_it() -> None:
    both = factors(views=9, exposure_spread=1.0, white_balance_spread=40.0)
    assert both.exposures == factors(views=9, exposure_spread=1.0).exposures
    assert both.balances == factors(views=9, white_balance_spread=40.0).balances
    many = factors(views=2000, exposure_spread=1.0, white_balance_spread=40.0)
    pair = np.log2(many.exposures), np.log2([red / blue for red, _, blue in many.balances])
    assert abs(np.corrcoef(pair)[0, 1]) < 5 / np.sqrt(2000)


def test_two_exposures_are_interleaved() -> None:
    assert factors(views=5, bracket=2.0).exposures == (1.0, 4.0, 1.0, 4.0, 1.0)
    times = factors(views=5, bracket=2.0, exposure_spread=0.5).exposures
    np.testing.assert_allclose(times, np.multiply(factors(views=5, exposure_spread=0.5).exposures, (1, 4, 1, 4, 1)))


@pytest.mark.parametrize("sensor", [NOISY, PRESETS["a7s2-iso6400"]])
def test_white_balance_errs_from_warm_to_cool_and_darkens_no_channel(sensor: Sensor) -> None:
    found = factors(views=200, sensor=sensor, white_balance_spread=50.0)
    red, green, blue = np.array(found.balances).T
    # by Wien's law: C2 (1/464.3 nm - 1/549.1 nm) = 4786 K, and so for red: stops of 50 mired between the channels
    warm, cool = np.log2(red / green), np.log2(blue / green)
    np.testing.assert_allclose(warm, -cool * (1 / 549.1 - 1 / 611.4) / (1 / 464.3 - 1 / 549.1), rtol=1e-4)
    assert 0.31 < np.abs(cool).max() < 50e-6 * 4786 / np.log(2) + 1e-4
    for view in range(20):
        seen = found.seen_by(sensor, view)
        np.testing.assert_allclose(white_balance(seen), white_balance(sensor) * found.balances[view], rtol=1e-12)
        assert min(white_balance(seen)) == 1.0  # or saturated pixels would come out coloured


def test_an_evened_view_has_the_light_of_the_common_exposure_and_the_noise_of_its_own() -> None:
    light, times = np.full((300, 300, 3), 40.0), 4.0
    uneven = Uneven(exposures=(times,), balances=((1.3, 1.0, 1.1),))
    longer = Exposure(time=times * TIME.time)
    frame = expose(times * light, NOISY, longer, seed=1, view=0)
    taken = from_linear16(develop(frame, uneven.seen_by(NOISY, 0)).linear16)
    found = uneven.even(taken, 0)
    clean = develop_linear(expose(light, NOISY, TIME, seed=1, view=0).clean_dn, NOISY)
    curve = linear_noise(NOISY, TIME)
    variance = curve.variance(times * clean[0, 0]) / times**2
    error = np.sqrt(variance / found[..., 0].size)
    assert (np.abs(found.mean((0, 1)) - clean[0, 0]) < 5 * error + 5 / 61439 / times).all()
    # rows share noise, so that the variance scatters by more than independent pixels' would
    np.testing.assert_allclose(found.var((0, 1)), variance, rtol=0.05)
    assert (variance < 0.5 * curve.variance(clean[0, 0])).all()
    raw = uneven.even_raw(frame.dn, 0, NOISY.black_level, NOISY.white_dn)
    np.testing.assert_allclose(raw.mean(), expose(light, NOISY, TIME, seed=2, view=0).dn.mean(), rtol=2e-3)


def test_what_may_be_cut_off_at_white_stays_white_in_every_channel() -> None:
    uneven = Uneven(exposures=(4.0,), balances=((1.5, 1.0, 1.0),))
    full = from_linear16(develop(np.full((2, 2, 3), 16383), uneven.seen_by(NOISY, 0)).linear16)
    np.testing.assert_array_equal(uneven.even(full, 0), 1.0)
    white = np.array([[NOISY.white_dn]])
    np.testing.assert_array_equal(uneven.even_raw(white, 0, NOISY.black_level, NOISY.white_dn), white)


def test_behind_a_colour_matrix_each_channel_of_the_camera_is_divided_by_its_own_factor() -> None:
    matrix = np.array([[1.6, -0.4, -0.2], [-0.2, 1.5, -0.3], [0.1, -0.5, 1.4]])
    uneven = Uneven(exposures=(2.0,), balances=((1.2, 1.0, 1.1),), matrix=tuple(map(tuple, matrix.tolist())))
    dn = np.random.default_rng(0).uniform(300, 3000, (8, 8, 3))
    taken = develop_linear(200 + 2.0 * (dn - 200), uneven.seen_by(NOISY, 0), color_matrix=matrix)
    np.testing.assert_allclose(uneven.even(taken, 0), develop_linear(dn, NOISY, color_matrix=matrix), atol=1e-6)


def test_views_that_are_alike_are_left_as_they_are() -> None:
    picture, dn = np.random.default_rng(0).random((4, 4, 3)).astype(np.float32), np.arange(12, dtype=np.uint16)
    assert EVEN.even(picture, 3) is picture
    assert EVEN.even_srgb(picture, 3) is picture
    assert EVEN.even_raw(dn, 3, 0.0, 100.0) is dn
    assert EVEN.seen_by(NOISY, 3) is NOISY


@pytest.mark.parametrize("count", [1, 4, 16])
def test_the_mean_of_a_burst_keeps_the_fixed_pattern_and_shrinks_the_rest(count: int) -> None:
    light = np.full((200, 200, 3), 40.0)
    bursts = [mean_of(expose_burst(light, NOISY, TIME, frames=count, seed=seed, view=0)) for seed in range(2)]
    difference = (bursts[0].dn.astype(float) - bursts[1].dn).ravel()
    temporal = difference.var() / 2
    np.testing.assert_allclose(temporal, bursts[0].variance_dn.mean(), rtol=0.05)
    curve = raw_noise(NOISY, TIME, frames=count)
    mean = bursts[0].clean_dn[0, 0]
    whole = np.mean([((burst.dn - mean) ** 2).mean() for burst in bursts])
    np.testing.assert_allclose(whole, curve.variance(mean).mean(), rtol=0.05)
    # the pattern: what both bursts share
    a, b = (burst.dn - mean for burst in bursts)
    pattern = raw_noise(NOISY, TIME).variance(mean) - raw_noise(NOISY, TIME, fixed_pattern=False).variance(mean)
    np.testing.assert_allclose((a * b).mean(), pattern.mean(), rtol=0.1)
    assert bursts[0].dn.dtype == np.uint16


def test_frames_of_a_burst_have_noise_of_their_own() -> None:
    light = np.full((64, 64, 3), 40.0)
    first, second = expose_burst(light, NOISY, TIME, frames=2, seed=0, view=0)
    pair = np.stack([(frame.dn - frame.mean_dn).ravel() for frame in (first, second)])
    assert abs(np.corrcoef(pair)[0, 1]) < 5 / np.sqrt(pair.shape[1])
    np.testing.assert_array_equal(first.mean_dn, second.mean_dn)
    assert mean_of([first]) is first
