"""`characterise` on frames of a camera of a few lines of numpy, which shares no code with ours.

As laboratories have it: lamps flicker, light falls off towards the corners, and some cameras cut noise off at black.
"""

from dataclasses import replace

import numpy as np
import pytest

from sensor_model import PRESETS, Exposure, Stack, characterise, expose, read_sensor, write_sensor
from sensor_model.characterisation import Characterisation, _straightened, noise_parts

SIDE, FULL, RATE, ETA = 160, 8000, 40_000.0, 0.6  # px, e-, e-/s, e- per photon
TRUE = {"gain": 2.0, "sigma_d": 3.0, "dark_current": 50.0, "prnu": 0.01, "dsnu": 1.0, "black_level": 100.0}
Y, X = np.mgrid[-1 : 1 : SIDE * 1j, -1 : 1 : SIDE * 1j]


def stack(
    electrons,
    time,
    n,
    seed,
    *,
    flicker=0.0,
    drift=0.0,
    shade=1.0,
    black=100.0,
    dark=50.0,
    hot=0.0,
    dsnu=1.0,
    row=0.0,
    column=0.0,
):
    """Frames of one light. A lamp flickers by a share, a black level drifts by DN, a shade lies over the field."""
    fixed, rng, apart = np.random.default_rng(1), np.random.default_rng(seed), np.random.default_rng([seed, 1])
    response = 1 + TRUE["prnu"] * fixed.normal(size=X.shape)
    offset = dsnu * fixed.normal(size=X.shape)
    dark = np.where(fixed.random(X.shape) < hot, 2000.0, dark)  # e-/s
    frames = []
    for _ in range(n):
        light = electrons * (1 + flicker * rng.normal()) * shade * response
        charge = np.minimum(rng.poisson(light) + rng.poisson(dark * time, X.shape), FULL)
        lines = row * apart.normal(size=(SIDE, 1)) + column * apart.normal(size=SIDE)
        voltage = charge + offset + TRUE["sigma_d"] * rng.normal(size=X.shape) + lines
        frames.append(np.clip(np.rint(TRUE["gain"] * voltage + black + drift * rng.normal()), 0, 65535))
    return np.stack(frames).astype(np.uint16)


def laboratory(**wrong):
    """Dark and flat stacks up to beyond saturation, of two frames or twenty."""
    dark = [Stack(stack(0.0, t, n, k, **wrong), t) for k, (t, n) in enumerate([(0.1, 20), (1.0, 6), (2.0, 6)])]
    levels = [(0.06, 6), (0.1, 6), (0.2, 6), (0.3, 6), (0.5, 20), (0.6, 6), (0.8, 6), (0.9, 6), (1.4, 6)]
    flat = [Stack(stack(f * FULL, f * FULL / RATE, n, 10 + k, **wrong), f * FULL / RATE, f * FULL / ETA)
            for k, (f, n) in enumerate(levels)]  # fmt: skip
    return dark, flat


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"flicker": 0.01},
        {"drift": 5.0},
        {"shade": 1 - 0.15 * (X**2 + Y**2)},
        {"shade": 1 + 0.05 * X - 0.03 * Y},
        {"shade": 1 + 0.06 * X * Y},
    ],
    ids=["steady", "lamp flickers", "black drifts", "falls off", "tilted light", "twisted light"],
)
def test_what_a_laboratory_cannot_hold_still_is_not_taken_for_noise(wrong):
    """A flicker of 1 % has, at half of this well, 0.4 of the variance of shot noise; a dim corner was PRNU.

    Tolerances: four standard errors of these few frames, and 2 % of PRNU for what a shade changes.
    """
    found = characterise(*laboratory(**wrong))
    for name, tolerance in (("gain", 0.01), ("sigma_d", 0.03), ("dark_current", 0.03), ("prnu", 0.03), ("dsnu", 0.05)):
        assert getattr(found, name) == pytest.approx(TRUE[name], rel=tolerance), name
    # what varies from frame to frame varies the means of so few frames too
    assert found.black_level == pytest.approx(TRUE["black_level"], abs=0.1 + 4 * wrong.get("drift", 0.0) / 6**0.5)
    reached = ETA * np.mean(wrong.get("shade", 1.0))  # photons are stated for the middle
    assert found.eta == pytest.approx(reached, rel=0.01 + 2 * wrong.get("flicker", 0.0) / 6**0.5)
    assert found.mu_e_sat == pytest.approx(FULL, rel=0.01)


def test_flats_just_beyond_saturation_show_the_full_well():
    """Some noise is left: four pixels in a hundred stay below."""
    dark, flat = laboratory()
    time = 1.02 * FULL / RATE
    flat[-1] = Stack(stack(1.02 * FULL, time, 6, 18), time, 1.02 * FULL / ETA)
    assert characterise(dark, flat).mu_e_sat == pytest.approx(FULL, rel=0.01)


def test_the_pattern_of_the_dark_is_not_counted_as_response():
    found = characterise(*laboratory(dsnu=20.0))
    assert found.dsnu == pytest.approx(20.0, rel=0.02)
    assert found.prnu == pytest.approx(TRUE["prnu"], rel=0.03)


def test_the_dark_charge_of_the_flats_is_that_of_their_own_time():
    """Pixels of 0 to 400 e-/s: after 0.1 s, the time of the flats, they differ by 12 electrons, after 2 s by 231."""
    found = characterise(*laboratory(dark=np.random.default_rng(2).uniform(0, 400, X.shape)))
    assert found.prnu == pytest.approx(TRUE["prnu"], rel=0.03)


def test_noise_of_rows_and_of_columns_is_told_from_that_of_pixels():
    """The eight pairs of dark frames hold 16 times 160 rows: four standard errors are 6 %."""
    found = characterise(*laboratory(row=1.5, column=0.8))
    assert found.sigma_row == pytest.approx(1.5, rel=0.06)
    assert found.sigma_column == pytest.approx(0.8, rel=0.08)
    assert found.sigma_d == pytest.approx(TRUE["sigma_d"], rel=0.03)


def test_hot_pixels_are_counted_by_themselves(tmp_path):
    """One in a thousand made 6.5 electrons of DSNU out of 1, and a dark current of 7 out of 5."""
    dark, flat = laboratory(hot=0.002)
    truth = float((np.mean(dark[2].frames, axis=0) > 2000).mean())
    assert 0.001 < truth < 0.003
    found = characterise(dark, flat)
    assert found.hot_fraction == truth
    assert found.hot_factor == pytest.approx(2000 / TRUE["dark_current"], rel=0.01)
    for name, tolerance in (("sigma_d", 0.03), ("dark_current", 0.03), ("prnu", 0.03), ("dsnu", 0.05), ("gain", 0.01)):
        assert getattr(found, name) == pytest.approx(TRUE[name], rel=tolerance), name

    write_sensor(tmp_path / "hot.toml", found.sensor(bits=16))
    camera = read_sensor(tmp_path / "hot.toml")
    assert (camera.defects.hot_fraction, camera.defects.hot_factor) == (found.hot_fraction, found.hot_factor)
    seen = [expose(np.zeros((400, 400)), camera, Exposure(time=1.0), seed=1, view=0, frame=i).dn for i in range(4)]
    mean, theirs = np.mean(seen), np.mean(dark[1].frames)  # with all its pixels it is as dark as the frames were
    assert mean == pytest.approx(theirs, abs=1.0)


@pytest.mark.parametrize(("name", "n"), [("d850-iso400", 2), ("d850-iso400", 4), ("prime-95b", 8)])
def test_heavy_tails_and_telegraph_pixels_are_not_hot(name, n):
    """Without dark current, 4 pixels in 10,000 of the two-frame stacks were hot, by 220 electrons a second."""
    true = replace(PRESETS[name], cfa=None, dark_current=0.0)

    def frames(share, time, view):
        light = np.full((200, 200), share * true.capacity_e / true.eta)
        return Stack(np.stack([expose(light, true, Exposure(time=time), seed=1, view=view, frame=i).dn
                               for i in range(n)]), time, float(light[0, 0]))  # fmt: skip

    dark = [frames(0.0, time, view) for view, time in enumerate((0.001, 0.03))]
    found = characterise(dark, [frames(share, 0.01, 2 + view) for view, share in enumerate((0.1, 0.3, 0.5, 0.9, 1.4))])
    assert found.hot_fraction == 0
    assert found.sensor(bits=true.bits).defects is None


def test_another_full_well_than_the_measured_one_keeps_the_bend_per_electron():
    found = replace(characterise(*laboratory()), mu_e_sat=4000.0, nonlinearity=0.04)
    assert found.sensor(bits=16).nonlinearity == 0.04
    assert found.sensor(bits=16, mu_e_sat=8000.0).nonlinearity == pytest.approx(0.08)
    assert found.sensor(bits=16, mu_e_sat=8000.0, nonlinearity=0.01).nonlinearity == 0.01


@pytest.mark.parametrize("hot", [0.0, 0.002])
def test_a_camera_without_dark_current_is_one(hot):
    """By chance its estimate is below 0 half of the time, and no camera could be made of it."""
    for seed in range(4):
        dark = [Stack(stack(0.0, t, n, 40 + 3 * seed + k, dark=0.0, hot=hot), t)
                for k, (t, n) in enumerate([(0.1, 20), (0.2, 6), (0.4, 6)])]  # fmt: skip
        found = characterise(dark, laboratory(dark=0.0, hot=hot)[1])
        camera = found.sensor(bits=16)
        assert 0 <= camera.dark_current < 0.5
        assert (camera.defects is None) == (hot == 0)
        if camera.defects is not None:
            reached = camera.dark_current * camera.defects.hot_factor
            assert reached == pytest.approx(2000, rel=0.03)


def test_frames_of_several_shapes_are_refused():
    dark, flat = laboratory()
    with pytest.raises(
        ValueError, match=r"frames must be of one shape in all stacks, got \[\(80, 160\), \(160, 160\)\]"
    ):
        characterise(dark, [replace(flat[0], frames=flat[0].frames[:, :80]), *flat[1:]])


def test_a_camera_that_cuts_its_noise_off_at_black_is_refused():
    """Read noise came out as 1.8 electrons instead of 3, and black as 2 DN instead of 0."""
    with pytest.raises(ValueError, match=r"dark pixels at 0 DN must be at most 0.005, got 0\.1.*raise the black level"):
        characterise(*laboratory(black=0.0))
    dark, flat = laboratory()
    with pytest.raises(ValueError, match="dark pixels at 0 DN"):  # one stack is enough
        characterise([Stack(stack(0.0, 0.1, 20, 0, black=0.0), 0.1), *dark[1:]], flat)
    characterise(*laboratory(black=20.0))  # three standard deviations: a pixel in a thousand


@pytest.mark.parametrize("time", ["one", "shuffled"])
def test_light_that_does_not_follow_what_is_stated_is_refused(time):
    """A lamp that is dimmed at one exposure time, without photons: the gain came out 14 % too low, without a word."""
    dark, flat = laboratory()
    times = [0.1] * len(flat) if time == "one" else [s.time for s in flat[::-1]]
    dimmed = [Stack(s.frames, t) for s, t in zip(flat, times, strict=True)]
    with pytest.raises(ValueError, match="flat signals over the exposure times must be at most 0.2.*state the photons"):
        characterise(dark, dimmed)
    with pytest.raises(ValueError, match="over the stated photons must be at most 0.2, got .*correct them$"):
        characterise(dark, [Stack(s.frames, 0.1, p.photons) for s, p in zip(flat, flat[::-1], strict=True)])
    known = [Stack(s.frames, s.time, s.photons) for s in flat]
    assert characterise(dark, known).gain == pytest.approx(TRUE["gain"], rel=0.01)


def test_the_bend_of_a_signal_is_undone_and_its_slope_never_vanishes() -> None:
    linear, slope = _straightened(np.array([0.0, 0.5, 1.0, 9.0]), 0.3)
    np.testing.assert_allclose(slope, [1.0, np.sqrt(1 - 0.6), 0.1, 0.1])
    np.testing.assert_allclose(linear, [0.0, 1 / (1 + np.sqrt(0.4)), 2 / 1.1, 18 / 1.1])


def test_noise_of_rows_is_that_of_all_dark_stacks() -> None:
    """Two stacks, of which one has noise of rows: its variance, 36 DN^2, counts half."""
    stacks = [Stack(stack(0.0, 0.01, 20, seed, row=row, dark=0.0), 0.01) for seed, row in enumerate((3.0, 0.0))]
    for order in (stacks, stacks[::-1]):
        assert noise_parts(order, 100.0)[0] == pytest.approx(18.0, rel=0.15)


def test_a_gain_that_is_known_better_turns_all_electrons_with_it_and_no_code() -> None:
    """Rationale: codes were measured; what is in electrons is theirs over the gain."""
    found = Characterisation(
        gain=2.0, eta=0.5, sigma_d=3.0, sigma_row=0.4, sigma_column=0.2, black_level=100.0, dark_current=0.7, dsnu=1.5,
        prnu=0.01, hot_fraction=0.001, hot_factor=20.0, mu_e_sat=8000.0, nonlinearity=0.02, linearity_error=0.01,
    )  # fmt: skip
    better = found.at_gain(2.5)
    assert better.gain == 2.5
    for name in ("sigma_d", "sigma_row", "sigma_column", "dark_current", "dsnu", "mu_e_sat", "eta"):
        assert getattr(better, name) == pytest.approx(getattr(found, name) * 2.0 / 2.5, rel=1e-12), name
    for name in ("black_level", "prnu", "hot_fraction", "hot_factor", "nonlinearity", "linearity_error"):
        assert getattr(better, name) == getattr(found, name), name
    unknown = replace(found, eta=None, mu_e_sat=None).at_gain(2.5)
    assert (unknown.eta, unknown.mu_e_sat) == (None, None)
