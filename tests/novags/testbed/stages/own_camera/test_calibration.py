"""A camera of a few lines of numpy at several ISOs is found again: its gains, the switch between them, its maps."""

from pathlib import Path

import numpy as np
import pytest

from novags.testbed.importing.calibration.camera import characterise_folder
from sensor_model import read_sensor, write_dng
from sensor_model.files.camera_file import read_camera, read_maps
from sensor_model.params import Exposure, Sensor
from tests.dngs import write_dng as write_tagged_dng

SHAPE, BLACK, PER_ISO = (96, 120), 128.0, 0.002  # DN/e- per ISO
ISOS = {100: 6.0, 200: 4.5, 400: 4.0, 800: 1.3, 1600: 1.2}  # read noise, e-: the pixels switch after 400
FIXED = np.random.default_rng(7)
OFFSET, RESPONSE = 1.0 * FIXED.normal(size=SHAPE), 1 + 0.01 * FIXED.normal(size=SHAPE)  # e-, and of the mean
OFFSET[10, 20] = 300.0


def frames(iso: int, electrons: float, n: int, seed: int) -> np.ndarray:
    rng, gain = np.random.default_rng([iso, seed]), PER_ISO * iso
    e = rng.poisson(electrons * RESPONSE, (n, *SHAPE)) + OFFSET + ISOS[iso] * rng.normal(size=(n, *SHAPE))
    return np.clip(np.rint(BLACK + gain * (e + 0.5 * rng.normal(size=(n, SHAPE[0], 1)))), 0, 16383).astype(np.uint16)


def write(folder: Path, iso: int, *, flat: bool = True, n: int = 16) -> None:
    """Dark frames of two times; flat ones up to a quarter of white, as the recipes say, none of them saturated."""
    stacks = {"dark/long": frames(iso, 0.0, n, 1)} | ({"dark/short": frames(iso, 0.0, 4, 0)} if flat else {})
    most = 4000 / (PER_ISO * iso)
    stacks |= {f"flat/{k}": frames(iso, share * most, n if k == 4 else 2, 10 + k)
               for k, share in enumerate((0.1, 0.3, 0.5, 0.7, 1.0)) if flat}  # fmt: skip
    for name, dn in stacks.items():
        (folder / name).mkdir(parents=True)
        np.save(folder / name / "a.npy", dn)


NOTES = "bits = 14\n[camera]\neta = 0.5\nmu_e_sat = inf\n" + "".join(
    f'[stacks."{name}"]\ntime = {time}\n'
    for name, time in (("dark/short", 0.1), ("dark/long", 1.0), ("flat/0", 0.1), ("flat/1", 0.3), ("flat/2", 0.5),
                       ("flat/3", 0.7), ("flat/4", 1.0))
)  # fmt: skip


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("laboratory")
    for iso in ISOS:
        write(folder / f"iso{iso}", iso)
    (folder / "frames.toml").write_text(NOTES)
    return folder


def test_a_camera_is_found_at_every_iso_with_its_line_of_gain_and_its_switch(
    laboratory: Path, tmp_path: Path, call, capsys
) -> None:
    """Rationale: the whole way of a user, from frames at five ISOs to --sensor at a sixth."""
    out = tmp_path / "mine.toml"
    assert call("characterise", str(laboratory), "--out", str(out)) == 0
    said, next_command = capsys.readouterr()
    assert "dual gain: the pixels switch between ISO 400 and 800" in said
    for iso, sigma in ISOS.items():
        found = read_sensor(f"{out}@{iso}")
        assert found.gain == pytest.approx(PER_ISO * iso, rel=0.04), iso
        assert found.sigma_d == pytest.approx(sigma, rel=0.06), iso
        assert found.mu_e_sat == np.inf
    low = read_camera(f"{out}@300")
    assert low.fit.isos == (100, 400)
    assert low.sensor.gain == pytest.approx(PER_ISO * 300, rel=0.02)
    assert low.fit.residual < 0.04
    assert f"--sensor {out}@1600" in next_command
    with pytest.raises(ValueError, match="ISO must be one of 100, 200, 400, 800, 1600"):
        read_sensor(f"{out}@600")


def test_frames_that_were_held_out_stand_beside_the_camera(laboratory: Path) -> None:
    """Mean, variance, variance of rows and quantile, of four frames in sixteen and of captures without light."""
    for iso, setting in characterise_folder(laboratory).settings.items():
        title, *rows = setting.test
        assert title.split() == "without light, DN mean variance variance of rows 99.9 % quantile".split()
        told = {row[:17].strip(): [float(v) for v in row[17:].split()] for row in rows}
        held = frames(iso, 0.0, 16, 1)[3::4].astype(float)
        assert told["held out"] == pytest.approx(
            [held.mean(), held.var((1, 2)).mean(), held.mean(2).var(1).mean(), np.quantile(held, 0.999)], rel=1e-4
        )
        for name in ("drawn", "by numbers"):
            mean, variance, rows_, quantile = told[name]
            assert mean == pytest.approx(told["held out"][0], abs=0.2)
            assert rows_ == pytest.approx(told["held out"][2], rel=0.5)
            # Numbers spread the one hot pixel over all, so that their quantile lies further out
            assert -1 <= quantile - told["held out"][3] <= (1 if name == "drawn" else np.inf)
            assert variance == pytest.approx(told["held out"][1], rel=0.05)


def test_maps_are_those_of_the_camera(laboratory: Path, tmp_path: Path, call) -> None:
    """Of 12 dark and 16 flat frames. With so few, noise is a part of every map; its spread is the pattern's."""
    out = tmp_path / "mine.toml"
    assert call("characterise", str(laboratory), "--out", str(out), "--maps") == 0
    found = read_camera(f"{out}@800")
    assert found.maps == tmp_path / "mine-iso800.npz"
    assert found.sensor.defects is None
    maps = read_maps(found.maps, SHAPE)
    usual = np.abs(OFFSET) < 10
    assert maps.offset[10, 20] == pytest.approx(300, abs=3)
    assert np.corrcoef(maps.offset[usual], OFFSET[usual])[0, 1] > 0.9
    assert maps.offset[usual].std() == pytest.approx(OFFSET[usual].std(), rel=0.05)
    assert np.corrcoef(maps.response.ravel(), RESPONSE.ravel())[0, 1] > 0.8
    assert maps.response.std() == pytest.approx(0.01, rel=0.1)
    assert maps.response.mean() == pytest.approx(1.0, abs=1e-3)
    middle = read_maps(found.maps, (50, 60))
    np.testing.assert_array_equal(middle.offset, maps.offset[22:72, 30:90])


def test_every_colour_has_a_response_of_one(tmp_path: Path) -> None:
    """Behind filters, green is the brighter one: its pixels do not become more sensitive ones."""
    write(tmp_path / "iso800", 800)
    for path in (tmp_path / "iso800" / "flat").rglob("*.npy"):
        dn = np.load(path).astype(float)
        dn[:, ::2, ::2] = BLACK + 0.5 * (dn[:, ::2, ::2] - BLACK)
        np.save(path, np.rint(dn).astype(np.uint16))
    (tmp_path / "frames.toml").write_text('cfa = "RGGB"\n' + NOTES)
    (setting,) = characterise_folder(tmp_path, maps=True).settings.values()
    planes = [setting.maps.response[y::2, x::2].mean() for y in (0, 1) for x in (0, 1)]
    assert planes == pytest.approx([1.0] * 4, abs=2e-3)


@pytest.mark.parametrize("iso", [100, 1600])
def test_without_flat_frames_the_gain_is_a_rule_and_marked_as_assumed(iso: int, tmp_path: Path, call, capsys) -> None:
    write(tmp_path / f"ISO_{iso}", iso, flat=False)
    (tmp_path / "frames.toml").write_text('bits = 14\n[stacks."dark/long"]\ntime = 1.0\n')
    out = tmp_path / "mine.toml"
    assert call("characterise", str(tmp_path), "--out", str(out)) == 0
    found = read_sensor(f"{out}@{iso}")
    assert found.gain == pytest.approx(0.1 * iso / 100)
    assert found.sigma_d * found.gain == pytest.approx(ISOS[iso] * PER_ISO * iso, rel=0.06)  # the DN are measured
    assert found.black_level == pytest.approx(BLACK, abs=0.5)
    for text in (capsys.readouterr().out, out.read_text()):
        assert f"gain {0.1 * iso / 100:.5g} assumed: 0.1 DN/e- at ISO 100 and 14 bits" in text
        assert "eta 0.6 assumed" in text
    assert "by numbers" in out.read_text()


def test_a_gain_that_is_given_is_not_assumed(tmp_path: Path) -> None:
    write(tmp_path, 400, flat=False)
    (tmp_path / "frames.toml").write_text('bits = 14\n[camera]\ngain = 0.8\n[stacks."dark/long"]\ntime = 1.0\n')
    (setting,) = characterise_folder(tmp_path).settings.values()
    assert setting.sensor.gain == 0.8
    assert setting.sensor.sigma_d == pytest.approx(4.0, rel=0.06)
    assert "gain" not in setting.assumed
    (tmp_path / "frames.toml").write_text('bits = 14\n[stacks."dark/long"]\ntime = 1.0\n')
    with pytest.raises(ValueError, match="ISO of dark frames without flat frames must be known, .*the folder isoN"):
        characterise_folder(tmp_path)


def test_the_noise_profile_of_a_dng_is_compared_with_the_gain(tmp_path: Path) -> None:
    """It states variances on a scale of 0 to 1: S of 0.4 DN/e- is 0.4 / (white - black)."""
    stated = [0.9 / (16383 - BLACK), 1e-7, 0.4 / (16383 - BLACK), 1e-7, 0.9 / (16383 - BLACK), 1e-7]
    place = tmp_path / "iso200" / "dark" / "long"
    for k, dn in enumerate(frames(200, 0.0, 6, 1)):
        write_tagged_dng(place / f"{k}.dng", dn, {51041: ("D", stated)}, black=[BLACK])
    (setting,) = characterise_folder(tmp_path).settings.values()
    assert setting.profile == pytest.approx(0.4, rel=1e-3)
    assert any("gain by file 0.4 DN/e- (DNG's NoiseProfile), 2 of the above" in line for line in setting.lines())


def test_raw_files_without_a_profile_say_none(tmp_path: Path) -> None:
    camera = Sensor(gain=0.4, eta=0.5, mu_e_sat=1e4, black_level=BLACK, bits=14)
    (tmp_path / "iso200" / "dark" / "long").mkdir(parents=True)
    for k, dn in enumerate(frames(200, 0.0, 6, 1)):
        write_dng(tmp_path / "iso200" / "dark" / "long" / f"{k}.dng", dn, camera, Exposure(time=1.0))
    (tmp_path / "frames.toml").write_text("bits = 14\n")
    (setting,) = characterise_folder(tmp_path).settings.values()
    assert setting.profile is None


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "iso200" / "dark").rename(folder / "gone"), r"iso200 needs a folder dark/"),
        (lambda folder: (folder / "frames.toml").write_text(NOTES.replace("mu_e_sat = inf\n", "")),
         "does not determine mu_e_sat: .*frames.toml; inf where the converter saturates first"),
        (lambda folder: (folder / "iso200" / "frames.toml").write_text('cfa = "RGGB"\n' + NOTES),
         "bits and filters of the ISOs of .* must be the same"),
    ],
)  # fmt: skip
def test_what_is_missing_at_one_iso_is_said(damage, message: str, tmp_path: Path) -> None:
    for iso in (100, 200):
        write(tmp_path / f"iso{iso}", iso)
    (tmp_path / "frames.toml").write_text(NOTES)
    damage(tmp_path)
    with pytest.raises(ValueError, match=message):
        characterise_folder(tmp_path)


def test_maps_of_a_few_frames_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "iso800", 800, n=4)
    (tmp_path / "frames.toml").write_text(NOTES)
    with pytest.raises(ValueError, match="a dark stack of 8 frames or more for maps, .* got 4: take some dozens"):
        characterise_folder(tmp_path, maps=True)
    assert characterise_folder(tmp_path).settings[800].test == ()  # none to hold out
