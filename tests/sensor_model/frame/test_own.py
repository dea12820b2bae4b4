"""Effects from outside: their part in frames, moments, plans, noise curves and camera files, by hand and by samples."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

import numpy as np
import pytest

from novags.testing import assert_effect
from sensor_model import (
    PRESETS,
    Exposure,
    Sensor,
    SensorOptics,
    expose,
    plan_effects,
    raw_noise,
    read_sensor,
    sensor_from_dict,
    write_sensor,
)
from sensor_model.effect_list import EFFECT_LIST, OwnEffect
from sensor_model.effects import standard_normal
from sensor_model.frame import own, streams

K = 2.0  # DN/e-
CAMERA = Sensor(gain=K, eta=0.5, mu_e_sat=inf, black_level=200.0, bits=16, sigma_d=1.5, cfa=None, serial=5)
EXPOSURE = Exposure(time=0.5)


@dataclass(frozen=True, kw_only=True)
class RippleSettings:
    """Noise of a share of the signal, on a slope over the rows."""

    share: float = 0.1
    slope: float = 0.5  # e- from row to row

    def __post_init__(self) -> None:
        if self.share < 0:
            raise ValueError(f"share must be >= 0, got {self.share}")


def ripple_mean(signal, pixels, settings):
    return settings.slope * pixels.rows


def ripple(signal, pixels, settings):
    return ripple_mean(signal, pixels, settings) + settings.share * signal * standard_normal(pixels.uniforms())


def ripple_variance(signal, pixels, settings):
    return settings.share**2 * (signal**2 + signal)  # of the mean signal: the square of a Poisson number is larger


def ripple_cost(signal, kept, exposure, settings):
    return settings.share**2 * (signal**2 + signal) / (2 * kept), settings.slope * 24 + 0 * signal


RIPPLE = OwnEffect(
    title="ripple", config=RippleSettings, sample=ripple, mean=ripple_mean, variance=ripple_variance, cost=ripple_cost
)


@pytest.fixture(autouse=True)
def rows() -> Iterator[None]:
    """The effect in the table, as an object."""
    EFFECT_LIST["ripple"] = RIPPLE
    yield
    del EFFECT_LIST["ripple"]


def with_ripple(sensor: Sensor = CAMERA, **settings: float) -> Sensor:
    return replace(sensor, effects={"ripple": settings})


def frames(sensor, electrons, count=300, shape=(12, 16)):
    light = np.full(shape, electrons / sensor.eta)
    return [expose(light, sensor, EXPOSURE, seed=2, view=0, frame=i) for i in range(count)]


@pytest.mark.parametrize(
    ("camera", "electrons"),
    [
        (CAMERA, 200.0),
        (replace(CAMERA, black_level=20.0), 8.0),  # black is near
        (replace(CAMERA, bits=12, mu_e_sat=1900.0), 1850.0),  # white is
        (replace(CAMERA, mu_e_sat=4000.0, nonlinearity=0.05), 800.0),
        (replace(CAMERA, coupling=0.02), 200.0),
    ],
    ids=["far from any limit", "near black", "near white", "bent response", "coupled pixels"],
)
def test_samples_have_the_analytic_mean_and_variance(camera: Sensor, electrons: float) -> None:
    taken = frames(with_ripple(camera, share=0.05), electrons, count=600)
    codes = np.stack([frame.dn for frame in taken]).astype(np.float64)
    mean, variance = taken[0].mean_dn.astype(np.float64), taken[0].variance_dn.astype(np.float64)
    # per row, because the mean differs from row to row
    off = (codes.mean(0) - mean).mean(1)
    assert np.abs(off).max() < 5 * np.sqrt(variance.mean() / 600 / 16)
    squares = ((codes - mean) ** 2 - variance).mean((1, 2))
    assert abs(squares.mean()) < 5 * squares.std() / 600**0.5 + 0.01 * variance.mean()  # clipped noise is no normal's


def test_the_moments_are_the_stated_ones() -> None:
    taken = frames(with_ripple(share=0.1, slope=0.5), 200.0, count=1)[0]
    plain = frames(CAMERA, 200.0, count=1)[0]
    np.testing.assert_allclose(
        taken.mean_dn - plain.mean_dn, np.broadcast_to(K * 0.5 * np.arange(12)[:, None], (12, 16))
    )
    np.testing.assert_allclose(taken.variance_dn - plain.variance_dn, K**2 * 0.01 * (200.0**2 + 200), rtol=1e-5)


def test_it_draws_from_a_stream_of_its_name_and_leaves_the_others_alone() -> None:
    quiet = frames(with_ripple(share=0.0, slope=0.5), 200.0, count=1)[0].dn.astype(int)
    plain = frames(CAMERA, 200.0, count=1)[0].dn.astype(int)
    np.testing.assert_array_equal(quiet - plain, np.broadcast_to(np.arange(12)[:, None], (12, 16)))
    u = streams.Draws(seed=2, view=0, frame=0).uniforms((12, 16, 1), streams.named("ripple 0"))[..., 0]
    noisy = frames(with_ripple(share=0.1, slope=0.0), 200.0, count=1)[0].dn.astype(int)
    signal = (plain - 200) / K
    np.testing.assert_allclose((noisy - plain) / K, 0.1 * signal * standard_normal(u), atol=0.6)  # two roundings
    assert streams.named("ripple 0") != streams.named("ripple 1") >= streams.FREE


def test_its_draws_differ_by_name_seed_frame_and_camera_and_a_crop_has_those_of_the_whole() -> None:
    def pixels(name="a", serial=1, origin=(0, 0), shape=(6, 8, 3), **draws: int) -> own.Pixels:
        exposure = Exposure(time=1.0, origin=origin)
        given = streams.Draws(**{"seed": 3, "view": 1, "frame": 2, "origin": origin, **draws})
        return own.Pixels(
            shape=shape, sensor_shape=(20, 20), exposure=exposure, _name=name, _serial=serial, _draws=given
        )

    for each, shape in (("pixel", (6, 8, 3)), ("row", (6, 1, 3)), ("column", (1, 8, 3)), ("frame", (1, 1, 1))):
        found = pixels().uniforms(each)
        assert found.shape == shape
        others = [pixels(name="b"), pixels(seed=4), pixels(view=2), pixels(frame=3)]
        assert all((found != other.uniforms(each)).all() for other in others)
        assert (found != pixels().uniforms(each, 1)).all()
        fixed = pixels().pattern(each)
        assert (fixed != pixels(serial=2).pattern(each)).all()
        assert (fixed == pixels(seed=4, frame=9).pattern(each)).all()
        assert (fixed != found).all()
        small = pixels(origin=(2, 4), shape=(3, 2, 3))
        for whole, part in ((found, small.uniforms(each)), (fixed, small.pattern(each))):
            part_of = whole[2:5] if whole.shape[0] > 1 else whole
            np.testing.assert_array_equal(part, part_of[:, 4:6] if whole.shape[1] > 1 else part_of)
    np.testing.assert_array_equal(pixels(origin=(2, 4)).rows[:, 0, 0], np.arange(2, 8))
    np.testing.assert_array_equal(pixels(origin=(2, 4)).columns[0, :, 0], np.arange(4, 12))
    with pytest.raises(ValueError, match="each must be pixel, row, column or frame, got 'cell'"):
        pixels().uniforms("cell")  # type: ignore[arg-type]


def test_two_effects_add_up_in_any_order() -> None:
    EFFECT_LIST["second"] = replace(RIPPLE, title="second")
    try:
        both = {"ripple": {"slope": 1.0}, "second": {"share": 0.2}}
        one, other = (replace(CAMERA, effects=dict(order)) for order in (both.items(), reversed(both.items())))
        np.testing.assert_array_equal(frames(one, 50.0, count=1)[0].dn, frames(other, 50.0, count=1)[0].dn)
        added = [
            frames(replace(CAMERA, effects={name: of}), 50.0, count=1)[0].dn.astype(int) for name, of in both.items()
        ]
        plain = frames(CAMERA, 50.0, count=1)[0].dn.astype(int)
        sum_of = frames(one, 50.0, count=1)[0].dn.astype(int) - plain
        np.testing.assert_allclose(sum_of, added[0] + added[1] - 2 * plain, atol=2)  # roundings
    finally:
        del EFFECT_LIST["second"]


def test_the_planner_weighs_it_says_the_plain_chain_and_leaves_it_out() -> None:
    def plan(tolerance: float = 0.05, **settings: float):
        return plan_effects(with_ripple(**settings), EXPOSURE, [100.0, 200.0], tolerance)

    assert plan(share=0.1)["ripple"].on
    assert "in the plain chain" in plan(share=0.1)["ripple"].reason
    # sd**2 / 2 V at the brighter end, where V is shot, read and rounding
    cost = 0.01 * (200.0**2 + 200) / (2 * (200 + 1.5**2 + 1 / (12 * K**2)))
    assert plan(share=0.1, slope=0.0)["ripple"].contribution == pytest.approx(cost, rel=1e-6)
    small = plan(share=0.001, slope=0.0).force(on=["poisson"])
    assert not small["ripple"].on
    light = np.full((12, 16), 300.0)
    without = expose(light, with_ripple(share=0.001, slope=0.0), EXPOSURE, seed=1, view=0, plan=small)
    np.testing.assert_array_equal(without.dn, expose(light, CAMERA, EXPOSURE, seed=1, view=0).dn)
    assert without.sensor.effects == {}
    forced = small.force(on=["ripple"])
    assert expose(light, with_ripple(share=0.001), EXPOSURE, seed=1, view=0, plan=forced).sensor.effects


def test_where_it_brings_black_or_white_near_nothing_is_left_out() -> None:
    camera = replace(CAMERA, black_level=60.0, dark_current=1e-3)
    assert not plan_effects(camera, EXPOSURE, [400.0, 500.0])["dark_current"].on
    assert plan_effects(with_ripple(camera, share=0.3), EXPOSURE, [400.0, 500.0])["dark_current"].on


@pytest.mark.parametrize("bend", [0.0, 0.01])
def test_the_noise_curve_has_its_variance_over_frames_and_over_places(bend: float) -> None:
    camera = replace(CAMERA, mu_e_sat=5000.0, nonlinearity=bend)
    effect = with_ripple(camera, share=0.1, slope=0.5)
    mean = np.array([210.0, 300.0, 2000.0, 8000.0]).reshape(-1, 1)
    signal = (mean[:, 0] - 200) / K
    places = np.var(0.5 * np.arange(own.COARSE[0]))
    start = 0.5 * np.arange(own.COARSE[0]).mean()  # the mean of a pixel without light
    for fixed, more in ((True, places), (False, 0.0)):
        curves = [raw_noise(of, EXPOSURE, channels=1, fixed_pattern=fixed) for of in (effect, camera)]
        assert curves[0].black[0] == pytest.approx(200 + K * start)
        with_it, plain = curves[0].variance(mean + K * start), curves[1].variance(mean)
        stated = K**2 * (0.01 * (signal**2 + signal) + more)
        whole = stated + plain[:, 0]
        np.testing.assert_allclose((with_it - plain)[:, 0] / whole, stated / whole, atol=0.02 if bend else 1e-6)


def test_a_variance_that_is_no_quadratic_is_said() -> None:
    EFFECT_LIST["ripple"] = replace(RIPPLE, variance=lambda signal, pixels, settings: 1e5 * (signal > 1000))
    with pytest.warns(UserWarning, match=r"variance of the effects ripple is no quadratic .* errs by \d+% at"):
        raw_noise(with_ripple(), EXPOSURE, channels=1)
    EFFECT_LIST["ripple"] = RIPPLE
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        raw_noise(with_ripple(), EXPOSURE, channels=1)


@pytest.mark.parametrize(
    ("part", "function", "said"),
    [
        ("sample", lambda s, p, c: np.nan * s, "sample of the effect ripple must be finite"),
        (
            "sample",
            lambda s, p, c: s[:3],
            r"effect ripple must be of a shape that broadcasts to \(12, 16, 1\)",
        ),
        ("mean", lambda s, p, c: p.uniforms(), "uniforms must be asked for in sample alone, got 'ripple'"),
        ("variance", lambda s, p, c: -1.0, "the variance of the effect ripple must be >= 0, got -1"),
    ],
)
def test_what_it_gives_is_checked(part: str, function, said: str) -> None:
    EFFECT_LIST["ripple"] = replace(RIPPLE, **{part: function})
    with pytest.raises(ValueError, match=said):
        _ = frames(with_ripple(), 10.0, count=1)[0].mean_dn


def test_a_camera_file_names_it_on_top_of_a_preset(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('preset = "a7s2-iso6400-3chip"\nsigma_d = 3\n[effects.ripple]\nshare = 0.2\n')
    camera = read_sensor(file)
    assert camera == replace(PRESETS["a7s2-iso6400-3chip"], sigma_d=3.0, effects={"ripple": {"share": 0.2}})
    write_sensor(tmp_path / "again.toml", camera)
    assert read_sensor(tmp_path / "again.toml") == camera
    assert hash(camera) == hash(read_sensor(file))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[effects.riple]", "the camera has an effect 'riple' that is not known here: name its file with --plugin"),
        ("[effects.prnu]", "prnu is an effect of novags, which fields of the camera set: give prnu"),
        ("[effects.ripple]\nsare = 1", "setting of the effect ripple, got 'effects.ripple.sare'; did you mean 'share'"),
        ("[effects.ripple]\nshare = -1", "the effect ripple of the camera: share must be >= 0, got -1"),
        ("[effects.ripple]\nshare = [1]", r"effects.ripple.share must be a number, text, true or false, got \[1\]"),
        ("effects = 3", "effects must be a table, got 3"),
        ("[effects]\nripple = 3", "effects.ripple must be a table, got 3"),
    ],
)  # fmt: skip
def test_a_camera_file_that_is_wrong_is_refused_by_name(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f'preset = "ideal"\n{text}\n')
    with pytest.raises(ValueError, match=said) as error:
        read_sensor(file)
    assert "mine.toml" in str(error.value)


def test_a_preset_that_is_not_there_is_refused_by_name(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('preset = "a7s3-iso6400"\n')
    with pytest.raises(
        ValueError, match="preset must be the name of a camera, got 'a7s3-iso6400'; did you mean 'a7s2-iso6400'"
    ):
        read_sensor(file)


def test_a_record_can_be_read_where_the_effect_is_not_known_and_no_frame_can_be_taken() -> None:
    camera = sensor_from_dict({"preset": None, **vars(CAMERA), "effects": {"gone": {"a": 1}}} | {"banding": None})
    assert camera.effects == {"gone": {"a": 1}}
    with pytest.raises(ValueError, match="effect 'gone' that is not known here"):
        frames(camera, 10.0, count=1)


def test_pixels_know_their_place_on_a_sensor_that_is_larger_than_the_frame() -> None:
    seen = []
    EFFECT_LIST["ripple"] = replace(RIPPLE, mean=lambda s, p, c: seen.append(p.sensor_shape) or 0.0)
    camera = with_ripple(replace(CAMERA, optics=SensorOptics(sensor_shape=(100, 200))))
    _ = frames(camera, 10.0, count=1)[0].mean_dn
    assert (100, 200) in seen


def test_the_assertion_for_authors_holds_and_notices_each_wrong_function() -> None:
    assert_effect(RIPPLE, RippleSettings(share=0.05))
    for part, wrong, said in (
        ("mean", lambda s, p, c: ripple_mean(s, p, c) * 1.05, "the mean at"),
        ("variance", lambda s, p, c: ripple_variance(s, p, c) * 1.1, "the variance at"),
        (
            "sample",
            lambda s, p, c: ripple(s, p, c) + 0.2 * (s - s.mean()),
            "covariance with the noise of the signal",
        ),
        ("cost", lambda s, k, e, c: (0 * s, 0 * s), "cost: the standard deviation errs by"),
    ):
        with pytest.raises(AssertionError, match=said):
            assert_effect(replace(RIPPLE, **{part: wrong}), RippleSettings(share=0.3))


def test_every_effect_of_the_table_that_is_functions_of_arrays_states_its_own_moments() -> None:
    rows = [row for row in EFFECT_LIST.values() if isinstance(row, OwnEffect)]
    assert RIPPLE in rows
    for row in rows:
        assert_effect(row)


def test_the_pixel_that_is_moved_most_says_how_far_effects_reach_and_the_worst_signal_what_they_cost():
    camera = with_ripple(share=0.1, slope=0.5)
    noise = 0.1 * np.sqrt(100.0**2 + 100.0)
    assert own.reach(camera, EXPOSURE, 100.0, 3) == pytest.approx(0.5 * 31 + 3 * noise)
    signal, kept = np.array([500.0, 5.0, 100.0]), np.full(3, 50.0)
    sd, mean, title = own.costs(camera, EXPOSURE, signal, kept)["ripple"]
    assert (sd, mean) == pytest.approx((0.01 * (500.0**2 + 500.0) / 100, 0.5 * 24))
    assert title.startswith("ripple")


def test_an_effect_that_is_not_there_is_named_wherever_it_stands() -> None:
    assert own.missing(["ripple"]) is None
    for names in (["ripple", "nothing"], ["nothing", "ripple"]):
        assert "nothing" in (own.missing(names) or "")
