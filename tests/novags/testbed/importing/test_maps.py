"""A small camera whose gain is far from 1: its maps, the test of its dark frames, and its gains at several ISOs."""

from pathlib import Path

import numpy as np
import pytest

from novags.testbed.importing.calibration.camera import MeasuredSetting, _pattern, characterise_folder
from sensor_model import Sensor

SHAPE, BLACK, GAIN, WELL = (32, 40), 100.0, 4.0, 3000.0
FIXED = np.random.default_rng(3)
OFFSET, RESPONSE = 3.0 * FIXED.normal(size=SHAPE), 1 + 0.04 * FIXED.normal(size=SHAPE)  # e-, and of the mean
HOT, DEAD = (5, 7), ([9, 10, 22, 21], [12, 27, 28, 13])
OFFSET[HOT], RESPONSE[DEAD] = 300.0, 0.0


def frames(electrons: float, n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    e = rng.poisson(electrons * RESPONSE, (n, *SHAPE)) + OFFSET + 2 * rng.normal(size=(n, *SHAPE))
    return np.rint(BLACK + GAIN * e).astype(np.uint16)


def write(folder: Path, stacks: dict[str, np.ndarray], head: str) -> None:
    """Stacks in one file each; the time of stack k is k + 1 s."""
    lines = [head]
    for name, codes in stacks.items():
        (folder / name).mkdir(parents=True)
        np.save(folder / name / "a.npy", codes)
        lines += [f'[stacks."{name}"]', f"time = {int(name[-1]) + 1}"]
    (folder / "frames.toml").write_text("\n".join(lines))


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first dark stack is the small one, and the brightest flat one, of most frames, is too bright for maps."""
    folder = tmp_path_factory.mktemp("laboratory")
    stacks = {"dark/0": frames(0.0, 4, 0), "dark/1": frames(0.0, 16, 1)}
    stacks |= {f"flat/{k}": frames((k + 1) * 0.16 * WELL, n, 2 + k) for k, n in enumerate((2, 2, 2, 16, 20))}
    write(folder, stacks, f'bits = 14\ncfa = "RGGB"\n[camera]\neta = 0.5\ngain = {GAIN}\nmu_e_sat = {WELL}')
    return folder


def test_maps_hold_electrons_and_shares_of_the_pixels_behind_every_filter(laboratory: Path) -> None:
    (setting,) = characterise_folder(laboratory, maps=True).settings.values()
    assert setting.maps is not None
    offset, response = setting.maps.offset, setting.maps.response
    assert offset is not None
    assert response is not None
    for found, true, odd in ((offset, OFFSET, HOT), (response, RESPONSE, DEAD)):
        for y, x in np.ndindex(2, 2):
            usual = np.ones(SHAPE, bool)
            usual[odd] = False
            seen, there = (array[y::2, x::2][usual[y::2, x::2]] for array in (found, true))
            assert np.corrcoef(seen, there)[0, 1] > 0.9
            assert seen.std() == pytest.approx(there.std(), rel=0.1)
    assert offset[HOT] == pytest.approx(300, abs=3)
    assert 0 == response.min() == response[DEAD].min() <= response[DEAD].max() < 0.01


def test_every_fourth_frame_of_the_larger_dark_stack_is_held_out_and_told_in_four_numbers(laboratory: Path) -> None:
    (setting,) = characterise_folder(laboratory).settings.values()
    titles, *rows = setting.test
    assert titles.split("  ")[-1].strip() == "99.9 % quantile"
    assert [title in titles for title in ("mean", "variance", "variance of rows")] == [True] * 3
    held = np.load(laboratory / "dark" / "1" / "a.npy")[3::4].astype(float)
    own = [held.mean(), held.var((1, 2)).mean(), held.mean(2).var(1).mean(), np.quantile(held, 0.999)]
    assert [row[:17].strip() for row in rows] == ["held out", "drawn", "by numbers"]
    assert [float(value) for value in rows[0][17:].split()] == pytest.approx(own, rel=1e-4)


def test_frames_that_were_held_out_are_compared_with_the_rest_of_their_own_stack(tmp_path: Path) -> None:
    """Two stacks of as many frames; without the held-out ones the other, of no dark charge, is the larger."""
    write(tmp_path, {"dark/0": frames(300.0, 12, 0), "dark/1": frames(0.0, 12, 1)},
          f"bits = 14\n[camera]\ngain = {GAIN}")  # fmt: skip
    (setting,) = characterise_folder(tmp_path).settings.values()
    held, drawn = (float(row[17:].split()[0]) for row in setting.test[1:3])
    assert held == pytest.approx(BLACK + GAIN * 300, rel=0.02)
    assert drawn == pytest.approx(held, rel=0.01)


def test_few_dark_frames_alone_show_the_noise_of_all_frames_and_no_pattern_of_their_own(tmp_path: Path) -> None:
    """Over n frames the squared deviations sum up to n - 1 variances, and 1 / n of it is left in their average."""
    dn = BLACK + GAIN * 3.0 * np.random.default_rng(5).normal(size=(5, 100, 100))
    write(tmp_path, {"dark/0": np.rint(dn).astype(np.uint16)}, f"bits = 14\n[camera]\ngain = {GAIN}")
    (setting,) = characterise_folder(tmp_path).settings.values()
    assert setting.sensor.sigma_d == pytest.approx(3.0, rel=0.02)
    assert setting.sensor.dsnu < 0.3


def test_noise_is_measured_in_codes_so_that_electrons_follow_a_gain_that_is_given(laboratory: Path) -> None:
    (setting,) = characterise_folder(laboratory).settings.values()
    found, sensor = setting.found, setting.sensor
    assert found is not None
    assert sensor.gain == GAIN != found.gain
    for name in ("sigma_d", "sigma_row", "sigma_column", "dsnu", "dark_current"):
        assert GAIN * getattr(sensor, name) == pytest.approx(found.gain * getattr(found, name), rel=1e-6), name
    assert sensor.mu_e_sat == WELL  # as given


def test_a_pattern_far_above_the_noise_is_kept_with_all_that_is_usual_for_it() -> None:
    """By the noise alone, a hundredth of the pattern, three quarters of the pixels would count as far off."""
    seen = np.random.default_rng(4).normal(size=4000)
    seen[0] = 50.0
    found = _pattern(seen, 1e-4)
    assert found[0] == 50.0
    np.testing.assert_allclose(found[1:], seen[1:], rtol=1e-3)
    halved = _pattern(seen, 0.75)  # of a variance of 1
    np.testing.assert_allclose(halved[1:], 0.5 * seen[1:], rtol=0.05)


def test_hot_pixels_of_long_dark_frames_move_no_other_pixel_and_keep_their_response(tmp_path: Path) -> None:
    """One in a hundred has 2000 e- in the largest dark stack, of 9 s, and little in the flat frames of 1 to 4 s."""
    rng = np.random.default_rng(6)
    hot = rng.permutation(SHAPE[0] * SHAPE[1]).reshape(SHAPE) < 13

    def exposed(electrons: float, n: int, time: float) -> np.ndarray:
        e = rng.poisson(electrons + 222.0 * time * hot, (n, *SHAPE)) + 2 * rng.normal(size=(n, *SHAPE))
        return np.rint(BLACK + GAIN * e).astype(np.uint16)

    stacks = {"dark/0": exposed(0.0, 12, 1.0), "dark/8": exposed(0.0, 24, 9.0)}
    stacks |= {f"flat/{k}": exposed((k + 1) * 0.15 * WELL, 16, k + 1.0) for k in range(4)}
    write(tmp_path, stacks, f"bits = 14\n[camera]\neta = 0.5\ngain = {GAIN}\nmu_e_sat = {WELL}")
    (setting,) = characterise_folder(tmp_path, maps=True).settings.values()
    maps = setting.maps
    assert maps is not None
    assert maps.offset is not None
    assert maps.response is not None
    assert maps.time == 9.0
    assert maps.offset[~hot].mean() == pytest.approx(0.0, abs=0.1)  # e-
    assert maps.offset[hot].mean() == pytest.approx(2000, rel=0.02)
    assert maps.response[hot].min() > 0.5  # it was 0


def test_flat_frames_near_saturation_make_no_map_though_there_are_more_of_them(tmp_path: Path) -> None:
    """0.8 of the well at a gain of 4: by 0.7 of the well in codes they are too bright."""
    bright = np.rint(BLACK + GAIN * np.random.default_rng(5).poisson(0.8 * WELL, (20, *SHAPE))).astype(np.uint16)
    stacks = {"dark/0": frames(0.0, 16, 6), "dark/1": frames(0.0, 2, 10)}
    stacks |= {f"flat/{k}": frames((0.2, 0.4, 0.6)[k] * WELL, 8 + 4 * k, 7 + k) for k in range(3)} | {"flat/3": bright}
    write(tmp_path, stacks, f"bits = 14\n[camera]\neta = 0.5\ngain = {GAIN}\nmu_e_sat = {WELL}")
    (setting,) = characterise_folder(tmp_path, maps=True).settings.values()
    assert setting.maps is not None
    assert setting.maps.response is not None
    assert setting.maps.response[DEAD].max() < 0.01  # the bright frames are of a sensor without these


def test_noise_that_is_mostly_below_a_code_leaves_no_pattern_in_maps(tmp_path: Path) -> None:
    """Each pixel shows another code in one frame at most."""
    codes = np.full((24, SHAPE[0] * SHAPE[1]), 100, np.uint16)
    for k in range(24):
        codes[k, k::200] = 101
    write(tmp_path, {"dark/0": codes.reshape(24, *SHAPE)}, "bits = 12\n[camera]\ngain = 0.5")
    with pytest.warns(UserWarning, match="its noise is below a code"):
        (setting,) = characterise_folder(tmp_path, maps=True).settings.values()
    assert setting.maps is not None
    np.testing.assert_array_equal(setting.maps.offset, 0.0)


def test_a_camera_has_a_line_of_gain_for_each_side_of_its_switch(tmp_path: Path) -> None:
    """Dark frames alone: gain is 0.1 DN/e- at ISO 100 and 14 bits, and the converter saturates first."""
    for iso, noise in ((100, 8.0), (200, 8.0), (800, 1.5), (1600, 1.5)):
        normal = np.random.default_rng(iso).normal(size=(6, *SHAPE))
        codes = np.rint(BLACK + 0.001 * iso * noise * normal).astype(np.uint16)
        write(tmp_path / f"iso{iso}", {"dark/0": codes}, "bits = 14")
    found = characterise_folder(tmp_path)
    for iso, setting in found.settings.items():
        assert setting.sensor.gain == pytest.approx(0.001 * iso)
        assert setting.sensor.mu_e_sat == pytest.approx((16383 - BLACK) / (0.001 * iso), rel=1e-3)
    assert [fit.isos for fit in found.fits] == [(100, 200), (800, 1600)]
    told = str(found)
    for line in ("ISO 100 to 200: gain = 0.001 ISO", "ISO 800 to 1600: gain = 0.001 ISO",
                 "dual gain: the pixels switch between ISO 200 and 800"):  # fmt: skip
        assert line in told


def test_the_gain_by_file_is_told_as_a_share_of_the_gain_that_was_found() -> None:
    sensor = Sensor(gain=0.2, eta=0.5, mu_e_sat=1e4, black_level=BLACK, bits=14)
    setting = MeasuredSetting(sensor=sensor, found=None, assumed={}, test=(), maps=None, profile=0.4)
    assert setting.lines()[-1].endswith("gain by file 0.4 DN/e- (DNG's NoiseProfile), 2 of the above")
