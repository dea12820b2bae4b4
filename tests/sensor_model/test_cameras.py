"""Cameras: their parameters, presets with sources, TOML files, and characterisation from frames."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from sensor_model import (
    PRESETS,
    Banding,
    Defects,
    DualGain,
    Exposure,
    Sensor,
    SensorOptics,
    Stack,
    characterise,
    expose,
    photons_for_electrons,
    read_sensor,
    write_sensor,
)
from sensor_model.effects import tukey_sd
from sensor_model.presets import SOURCES

BASE = {"gain": 0.8, "eta": 0.5, "mu_e_sat": 5000.0, "black_level": 60.0, "bits": 12}


@pytest.mark.parametrize("name", list(PRESETS))
def test_every_value_of_every_preset_has_a_source(name):
    sensor = PRESETS[name]
    plain = Sensor(gain=1.0, eta=1.0, mu_e_sat=1.0, black_level=0.0, bits=8)
    for field in sensor.__dataclass_fields__:
        if getattr(sensor, field) != getattr(plain, field):
            assert SOURCES[name][field]


@pytest.mark.parametrize("name", list(PRESETS))
def test_no_assumed_number_passes_for_a_measured_one(name):
    """Only the IMX900, the Prime 95B and the ideal camera come with a measured quantum efficiency."""
    measured = name.startswith(("imx900", "prime-95b", "ideal"))
    assert SOURCES[name]["eta"] != "assumed" if measured else SOURCES[name]["eta"] == "assumed"
    if PRESETS[name].rgb_response != (1.0, 1.0, 1.0):
        assert SOURCES[name]["rgb_response"] == "assumed"


def test_an_assumed_quantum_efficiency_does_not_matter_where_light_is_given_in_electrons():
    sensor, radiance = PRESETS["a7s2-iso6400-3chip"], np.random.default_rng(0).random((40, 50, 3))
    frames = []
    for eta in (0.3, 0.6):
        camera = replace(sensor, eta=eta)
        light = photons_for_electrons(radiance, electrons=20.0, mean_green=0.5, sensor=camera)
        frames.append(expose(light, camera, Exposure(time=0.03), seed=0, view=0).dn)
    assert (frames[0] != frames[1]).mean() < 1e-3  # the last bit of the mean charge


def test_presets_carry_the_published_numbers():
    lcg, hcg = PRESETS["imx900-lcg"], PRESETS["imx900-hcg"]
    assert (lcg.gain, lcg.eta, lcg.sigma_d, lcg.mu_e_sat, lcg.dsnu, lcg.prnu) == (0.399, 0.9125, 5.56, 9458, 3.7, 0.007)
    assert (hcg.gain, hcg.eta, hcg.sigma_d, hcg.mu_e_sat, hcg.dsnu, hcg.prnu) == (
        1.673,
        0.8847,
        1.954,
        2183,
        1.3,
        0.008,
    )
    # PMN's own Gaussian fits of the same dark frames, DN: what its Tukey scales must come to within 2 %
    for iso, sigma in ((100, 1.0067), (1600, 6.2993), (2000, 2.6539), (6400, 7.1164), (25600, 25.853)):
        sensor = PRESETS[f"a7s2-iso{iso}"]
        assert sensor.sigma_d * sensor.gain == pytest.approx(sigma, rel=0.02)
    # dual gain: between ISO 1600 and 2000 the read noise falls to a third
    assert PRESETS["a7s2-iso2000"].sigma_d < 0.35 * PRESETS["a7s2-iso1600"].sigma_d
    assert 3.2283993 * tukey_sd(-0.0441045) == pytest.approx(1.53008 * PRESETS["a7s2-iso1600"].sigma_d)


@pytest.mark.parametrize("name", list(PRESETS))
def test_a_three_chip_preset_differs_by_its_filter_array_only(name):
    if not name.endswith("-3chip"):
        assert PRESETS[f"{name}-3chip"] == replace(PRESETS[name], cfa=None)


FULL = Sensor(
    **BASE, sigma_d=2.5, tukey_lambda=-0.05, dark_current=1.5, cfa=None, rgb_response=(0.5, 1.0, 0.7), serial=2**63,
    blooming=True, banding=Banding(amplitude=0.5, period=40),
    optics=SensorOptics(falloff=(1.0, 0.9, 0.6), sensor_shape=(80, 90), psf=((0.1, 0.8, 0.1),)), coupling=0.01,
    defects=Defects(hot_fraction=1e-4, hot_factor=100, rts_traps=3),
    dual_gain=DualGain(threshold=800, sigma_d=9, ratio=8),
)  # fmt: skip


@pytest.mark.parametrize("sensor", [*PRESETS.values(), FULL, replace(FULL, mu_e_sat=np.inf)])
def test_a_camera_file_reads_back_exactly(sensor, tmp_path):
    path = tmp_path / "camera.toml"
    write_sensor(path, sensor, comment="my camera\nmeasured today")
    assert read_sensor(path) == sensor
    assert path.read_text().startswith("# my camera\n# measured today\ngain = ")


def test_the_table_of_the_optics_keeps_its_name_in_camera_files(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(
        "gain = 0.5\neta = 0.6\nmu_e_sat = 9000\nblack_level = 64\nbits = 12\n[optics]\ncorner_angle = 20\n"
    )
    assert read_sensor(path).optics == SensorOptics(corner_angle=20)
    write_sensor(path, read_sensor(path))
    assert "\n[optics]\ncorner_angle = 20.0\n" in path.read_text()


@pytest.mark.parametrize("number", [np.float64, np.float32])
def test_a_camera_of_numpy_numbers_is_written_as_plain_ones(number, tmp_path):
    defects = Defects(hot_fraction=number(0.25), rts_traps=np.int64(3))
    fields = {"gain": number(1.5), "bits": np.int64(12), "mu_e_sat": number(np.inf), "blooming": np.bool_(True)}
    sensor = Sensor(**(BASE | fields), rgb_response=(number(0.5), 1.0, number(0.75)), defects=defects)
    write_sensor(tmp_path / "camera.toml", sensor)
    assert read_sensor(tmp_path / "camera.toml") == sensor


GOOD = "gain = 1.5\neta = 0.6\nmu_e_sat = 5000\nblack_level = 64\nbits = 12\n"


def test_a_camera_file_may_leave_out_what_has_a_default(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(GOOD + "[defects]\nhot_fraction = 1e-4\nhot_factor = 50\n")
    assert read_sensor(path) == Sensor(
        gain=1.5, eta=0.6, mu_e_sat=5000, black_level=64, bits=12, defects=Defects(hot_fraction=1e-4, hot_factor=50)
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD + "sigma_read = 2.0", "key must be a camera parameter, got 'sigma_read'"),
        (GOOD + "tukey_lamda = 0.1", "did you mean 'tukey_lambda'"),
        (GOOD + "sigma_d = 'two'", "sigma_d must be a number, got 'two'"),
        (GOOD + "prnu = true", "prnu must be a number"),
        (GOOD.replace("12", "12.5"), "bits must be a whole number"),
        (GOOD + "eta = 0.5", "camera.toml"),  # twice: not TOML
        (GOOD.replace("eta = 0.6", "eta = 60"), r"eta must be in \(0, 1\], got 60.0"),
        ("gain = 1.5", "eta, mu_e_sat, black_level, bits missing"),
        (GOOD + "defects = 3", "defects must be a table"),
        (GOOD + "[defects]\nhot_pixels = 3", "got 'defects.hot_pixels'"),
        (GOOD + "[banding]\namplitude = 3", "banding.period missing"),
        (GOOD + "cfa = 'RGBW'", "cfa must be one of 'none', 'RGGB', .*, got 'RGBW'"),
        (GOOD + "cfa = 3", "cfa must be one of 'none', .*, got 3"),
        (GOOD + "rgb_response = 1", "rgb_response must be a list of numbers"),
        (GOOD + "[optics]\npsf = [1, 2]", "psf must be a list of lists"),
        (GOOD + "[optics]\nsensor_shape = [80.5, 90]", "sensor_shape must be None or"),
        (GOOD + "blooming = 1", "blooming must be true or false"),
    ],
)
def test_a_faulty_camera_file_says_which_key_and_where(text, message, tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_sensor(path)
    assert "camera.toml" in str(caught.value)


def stacks(sensor, n_mid=30, shape=(200, 200)):
    """Dark and flat stacks as a laboratory takes them: thirty times, two frames each, and one large pair of stacks."""
    longest = 1.0
    times = np.linspace(0.01, 1, 24) * longest
    rate = 1.1 * sensor.mu_e_sat / sensor.eta / longest

    def stack(t, photons, n, seed):
        light, exposure = np.full(shape, photons), Exposure(time=t)
        frames = [expose(light, sensor, exposure, seed=seed, view=0, frame=i).dn for i in range(n)]
        return Stack(np.stack(frames), t, photons)

    dark = [stack(t, 0.0, 2, 2 * i) for i, t in enumerate(times)] + [stack(times[11], 0.0, n_mid, 900)]
    flat = [stack(t, rate * t, 2, 2 * i + 1) for i, t in enumerate(times)]
    return dark, [*flat, stack(times[11], rate * times[11], n_mid, 901)]


ODD = Sensor(
    gain=0.83, eta=0.37, mu_e_sat=4900.0, black_level=61.0, bits=13, sigma_d=3.7, sigma_row=0.9, sigma_column=0.6,
    dsnu=2.1, prnu=0.013, dark_current=150.0, cfa=None, serial=4711,
)  # fmt: skip


@pytest.mark.parametrize("name", ["imx900-hcg", "odd"])
def test_characterisation_finds_the_camera_behind_its_frames(name, tmp_path):
    sensor = ODD if name == "odd" else replace(PRESETS[name], cfa=None, dark_current=100.0)
    found = characterise(*stacks(sensor))
    for field, tolerance in (
        ("gain", 0.006), ("eta", 0.006), ("sigma_d", 0.015), ("dark_current", 0.01), ("dsnu", 0.02), ("prnu", 0.02),
        ("mu_e_sat", 0.006),
    ):  # fmt: skip
        assert getattr(found, field) == pytest.approx(getattr(sensor, field), rel=tolerance), field
    assert found.black_level == pytest.approx(sensor.black_level, abs=0.1)
    assert found.sigma_row == pytest.approx(sensor.sigma_row, abs=0.1)
    assert found.sigma_column == pytest.approx(sensor.sigma_column, abs=0.1)
    assert found.linearity_error < 0.002
    assert found.nonlinearity < 0.002

    write_sensor(tmp_path / "found.toml", found.sensor(bits=sensor.bits, serial=1))
    again = read_sensor(tmp_path / "found.toml")
    assert again.gain == found.gain
    assert again.bits == sensor.bits


def plain_gain(dark, flat):
    """Slope of temporal variance over mean, both less the dark, up to 70 % of saturation. DN/e-."""
    mean, variance = (
        np.array([q(f) - q(d) for d, f in zip(dark, flat, strict=True)])
        for q in (lambda s: s.frames.mean(), lambda s: s.frames.var(0, ddof=1).mean())
    )
    used = mean < 0.7 * mean[np.argmax(variance)]
    return mean[used] @ variance[used] / (mean[used] @ mean[used])


@pytest.mark.parametrize("bent", [0.02, 0.08])
def test_characterisation_sees_a_bent_response_and_is_not_misled_by_it(bent):
    """Rationale: the plain photon transfer curve reads the gain 3 % low at 2 % of non-linearity."""
    fields = {"bits": 14, "sigma_d": 3.0, "dark_current": 50.0, "prnu": 0.012, "nonlinearity": bent, "cfa": None}
    sensor = Sensor(**(BASE | fields))
    frames = stacks(sensor)
    assert 1 - plain_gain(*frames) / sensor.gain == pytest.approx(1.5 * bent, rel=0.1)
    found = characterise(*frames)
    assert found.nonlinearity == pytest.approx(bent, abs=0.0015, rel=0.03)
    assert found.linearity_error > bent / 10
    for field, tolerance in (("gain", 0.006), ("eta", 0.006), ("prnu", 0.02), ("mu_e_sat", 0.006), ("sigma_d", 0.015)):
        assert getattr(found, field) == pytest.approx(getattr(sensor, field), rel=tolerance), field


@pytest.mark.parametrize("name", ["imx900-lcg", "imx900-hcg", "odd"])
def test_characterisation_agrees_with_emva_1288_on_the_same_frames(name, emva1288):
    """Independent reference, on real statistics rather than on the truth: both see the same frames.

    The package counts temporal row noise as dark noise; so this camera has none.
    """
    odd = replace(ODD, sigma_row=0.0, sigma_column=0.0)
    sensor = odd if name == "odd" else replace(PRESETS[name], cfa=None, dark_current=PRESETS[name].mu_e_sat / 30)
    dark, flat = stacks(sensor)
    raw = {"temporal": {}, "spatial": {}, "height": 200, "width": 200}
    for d, f in zip(dark, flat, strict=True):
        pair = {s.photons: emva1288.routines.get_int_imgs(list(s.frames)) for s in (d, f)}
        if len(d.frames) > 2:
            raw["spatial"][d.time * 1e9] = pair
            continue
        raw["temporal"][d.time * 1e9] = {
            p: {"sum": i["sum"].sum(), "pvar": i["pvar"].sum(), "dmean": i["dmean"]} for p, i in pair.items()
        }
    theirs = emva1288.Results1288(emva1288.Data1288(raw, loglevel=logging.ERROR).data, loglevel=logging.ERROR)
    ours = characterise(dark, flat)
    assert ours.gain == pytest.approx(theirs.K, rel=0.005)
    assert 100 * ours.eta == pytest.approx(theirs.QE, rel=0.005)
    assert ours.sigma_d == pytest.approx(theirs.sigma_d, rel=0.02)
    assert ours.dark_current == pytest.approx(theirs.u_I_mean, rel=0.005)
    assert ours.dsnu == pytest.approx(theirs.DSNU1288, rel=0.01)
    assert 100 * ours.prnu == pytest.approx(theirs.PRNU1288, rel=0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda d, f: ([replace(d[0], time=0.5)] * 2, f),
            r"dark must be stacks at two exposure times or more, got \[0.5\]",
        ),
        (lambda d, f: (d, f[:2]), "flat must be three stacks"),
        (lambda d, f: (d, [f[-2]] * 3), "a stack below 70 % of saturation"),
        (lambda d, f: (d, [f[0], f[12], f[-2]]), "three stacks or more from 5 % to 95 %"),
    ],
)
def test_too_little_to_characterise_is_refused(change, message):
    dark, flat = stacks(replace(PRESETS["imx900-hcg"], cfa=None), n_mid=2, shape=(16, 16))
    with pytest.raises(ValueError, match=message):
        characterise(*change(dark, flat))
    with pytest.raises(ValueError, match="frames must be"):
        Stack(np.zeros((1, 16, 16)), 1.0)


def test_an_unsaturated_series_leaves_full_well_to_the_user():
    sensor = Sensor(**(BASE | {"mu_e_sat": 50_000.0, "bits": 16}), sigma_d=3.0, dark_current=50.0, cfa=None)
    dark, flat = stacks(sensor, n_mid=2, shape=(64, 64))
    found = characterise(dark, [f for f in flat if f.time < 0.6])
    assert found.mu_e_sat is None
    with pytest.raises(ValueError, match="mu_e_sat must be known"):
        found.sensor(bits=16)
    assert found.sensor(bits=16, mu_e_sat=50_000.0).mu_e_sat == 50_000.0


def test_the_read_noise_of_the_imx686_is_what_pmn_measured_at_its_highest_iso():
    """The preset is PMN's fit over ISO 640 to 6400, 12.51 DN; within its scatter lies the measured value, 12.89 DN."""
    sensor = PRESETS["imx686-iso6400"]
    assert sensor.sigma_d * sensor.gain == pytest.approx(12.515, abs=5e-4)
    scatter = 0.02921  # of ln sigma about the fit
    assert 0 < np.log(12.8901 / (sensor.sigma_d * sensor.gain)) / scatter < 2
    assert np.log(14.3036 / (sensor.sigma_d * sensor.gain)) / scatter > 4  # of the table that PMN does not use
    assert "get_camera_noisy_params" in SOURCES["imx686-iso6400"]["sigma_d"]


def test_every_quantum_efficiency_says_where_it_was_measured_or_that_it_is_assumed():
    for name in PRESETS:
        origin = SOURCES[name]["eta"]
        known = {"imx900": "FRAMOS, at 536 nm", "prime-": "Prime 95B, its largest", "ideal": "by definition"}
        assert origin == next((text for start, text in known.items() if name.startswith(start)), "assumed")


@pytest.mark.parametrize("name", [name for name, sensor in PRESETS.items() if sensor.sigma_row])
def test_row_noise_is_a_small_part_of_the_read_noise(name):
    """As all of its sources measured it: at most a fifth, in electrons."""
    sensor = PRESETS[name]
    assert 0 < sensor.sigma_row < 0.2 * sensor.sigma_d


@pytest.mark.parametrize(
    ("name", "read", "row"),
    [
        ("a7s2-iso6400", 3.4502964 * tukey_sd(-0.07517104), 0.7218788),
        ("imx385-iso6400", 130.818508**0.5, np.exp(0.93368 * np.log(13.486051) - 2.19692)),
        ("imx686-iso6400", 12.51, np.exp(0.87611 * np.log(8.74253) - 2.11455)),
        ("d850-iso1600", np.exp(0.95467 * np.log(6.640625) + 0.18022), np.exp(0.96623 * np.log(6.640625) - 2.69533)),
    ],
)
def test_noise_that_was_published_in_codes_is_that_noise_in_electrons(name, read, row):
    sensor = PRESETS[name]
    assert sensor.sigma_d * sensor.gain == pytest.approx(read, rel=1e-3)
    assert sensor.sigma_row * sensor.gain == pytest.approx(row, rel=1e-3)
