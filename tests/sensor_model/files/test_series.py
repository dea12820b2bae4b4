"""Cameras at several ISOs: one file, a line of gain over ISO for each gain of the pixels, and what lies between."""

import re
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sensor_model import PRESETS, Banding, Defects, DualGain, Measured, SensorOptics, read_sensor, write_sensor
from sensor_model.characterisation import gain_fits
from sensor_model.files.camera_file import read_camera, read_maps, split_iso, write_maps

STOPS = (100, 200, 400, 800, 1600, 3200, 6400, 12800, 25600)
A7S2 = {iso: PRESETS[f"a7s2-iso{iso}"] for iso in STOPS}


def fits_of(cameras: dict) -> list:
    return gain_fits(list(cameras), [c.gain for c in cameras.values()], [c.sigma_d for c in cameras.values()])


def write(path: Path, cameras: dict = A7S2, **more) -> Path:
    write_sensor(path, cameras, comment="measured", fits=fits_of(cameras), **more)
    return path


def test_the_switch_of_a_dual_gain_is_found_where_the_read_noise_falls() -> None:
    """Rationale: the Sony A7S II, of PMN's published table, switches between ISO 1600 and 2000."""
    low, high = fits_of(A7S2)
    assert (low.isos, high.isos) == ((100, 1600), (3200, 25600))
    assert low.slope == pytest.approx(0.0009563, rel=1e-3)
    assert high.gain(5000) == pytest.approx(0.0009563 * 5000, rel=1e-3)
    assert max(low.residual, high.residual) < 1e-3


@pytest.mark.parametrize(
    ("name", "isos"), [("imx385", (1600, 3200, 6400, 12800, 25600)), ("d850", (400, 1600, 6400)),
                       ("imx686", (800, 1600, 6400))],
)  # fmt: skip
def test_a_camera_of_one_gain_has_no_switch(name: str, isos: tuple) -> None:
    (fit,) = fits_of({iso: PRESETS[f"{name}-iso{iso}"] for iso in isos})
    assert fit.isos == (isos[0], isos[-1])
    if name == "imx385":  # whose gain at 100 times the ISO is not quite 100 times as large
        assert 0.005 < fit.residual < 0.05


def test_a_switch_of_the_gain_itself_gives_each_side_a_line_of_its_own() -> None:
    """0.001 DN for an electron and ISO, and 0.004 behind the switch, where noise before the amplifier is 1 electron."""
    cameras = {iso: replace(A7S2[100], gain=(0.001 if iso < 500 else 0.004) * iso, sigma_d=5.0 if iso < 500 else 1.0)
               for iso in (100, 200, 400, 800, 1600)}  # fmt: skip
    low, high = fits_of(cameras)
    assert (low.isos, high.isos) == ((100, 400), (800, 1600))
    assert (low.slope, high.slope) == pytest.approx((0.001, 0.004))


@pytest.mark.parametrize("noise", [0.0, 0.1, -0.1])
def test_errors_of_a_measurement_are_no_switch(noise: float) -> None:
    cameras = {iso: replace(PRESETS["imx385-iso1600"], gain=iso / 400, sigma_d=2 * (1 + noise * (-1) ** k))
               for k, iso in enumerate(STOPS)}  # fmt: skip
    assert len(fits_of(cameras)) == 1


def test_a_file_of_several_isos_reads_back_exactly_at_each(tmp_path: Path) -> None:
    path = write(tmp_path / "mine.toml", maps={3200: "mine-3200.npz"})
    for iso, camera in A7S2.items():
        found = read_camera(f"{path}@{iso}")
        assert found.sensor == camera
        assert found.iso == iso
        assert found.maps == (tmp_path / "mine-3200.npz" if iso == 3200 else None)
    assert read_camera(f"{path}@1600").fit.isos == (100, 1600)
    assert path.read_text().startswith("# measured\n")
    assert path.read_text().count("bits = 14") == 1  # what all share is said once


def test_one_setting_has_a_file_without_isos(tmp_path: Path) -> None:
    write_sensor(tmp_path / "one.toml", A7S2[100], maps="one.npz")
    found = read_camera(tmp_path / "one.toml")
    assert (found.sensor, found.iso, found.maps) == (A7S2[100], None, tmp_path / "one.npz")
    with pytest.raises(ValueError, match=r"one.toml: a camera without tables \[iso.N\] must be named without @"):
        read_camera(f"{tmp_path / 'one.toml'}@100")


def test_an_iso_between_two_has_the_gain_of_the_line_and_noise_between_theirs(tmp_path: Path) -> None:
    """566 is half way from 400 to 800 by the logarithm."""
    between = read_sensor(f"{write(tmp_path / 'mine.toml')}@566")
    assert between.gain == pytest.approx(0.0009563 * 566, rel=1e-3)
    assert between.sigma_d == pytest.approx((A7S2[400].sigma_d + A7S2[800].sigma_d) / 2, rel=1e-3)
    assert between.tukey_lambda == pytest.approx((A7S2[400].tukey_lambda + A7S2[800].tukey_lambda) / 2, rel=1e-2)
    assert (between.bits, between.cfa, between.mu_e_sat) == (14, "RGGB", A7S2[400].mu_e_sat)


@pytest.mark.parametrize(
    ("iso", "gain"), [(141, 0.0009563 * 141), (4525, 0.0009563 * 4525), (17960, 0.0009563 * 17960)]
)
def test_the_gain_between_two_isos_is_that_of_their_own_side_of_the_switch(
    iso: int, gain: float, tmp_path: Path
) -> None:
    found = read_camera(f"{write(tmp_path / 'mine.toml')}@{iso}")
    assert found.sensor.gain == pytest.approx(gain, rel=2e-3)
    assert found.fit == next(fit for fit in fits_of(A7S2) if fit.isos[0] < iso < fit.isos[1])


TWO = """
bits = 12
eta = 0.5
black_level = 64
[[gain_fit]]
isos = [100, 1600]
slope = 0.01
start = 0.0
residual = 0.0
[iso.100]
gain = 1
cfa = "GBRG"
sigma_d = 1
sigma_row = 0.5
mu_e_sat = inf
dark_doubling = 6
rgb_response = [0.4, 1, 0.8]
banding = {amplitude = 2, period = 9}
defects = {hot_fraction = 0.1, hot_factor = 10, rts_traps = 1}
optics = {falloff = [1, 0.5], sensor_shape = [30, 40]}
[iso.1600]
gain = 16
sigma_d = 5
sigma_column = 0.7
mu_e_sat = 8000
dark_doubling = inf
rgb_response = [0.8, 1, 0.4]
rgb_bias = [1, 0, 2]
dual_gain = {threshold = 500, sigma_d = 9, ratio = 8}
defects = {hot_fraction = 0.5, rts_factor = 3, rts_traps = 4}
optics = {falloff = [1, 0.75, 0.25]}
"""


@pytest.mark.parametrize("first", [100, 1600])
def test_between_two_isos_numbers_lie_between_and_all_else_is_the_nearer_ones(first: int, tmp_path: Path) -> None:
    """A quarter and three quarters of the way by the logarithm. Hot pixels or noise of columns may be found at one
    ISO alone, tables differ in length, a count stays whole, and the ISOs may stand in any order."""
    camera, *tables = TWO.split("[iso.")
    (tmp_path / "mine.toml").write_text("[iso.".join([camera, *(tables if first == 100 else tables[::-1])]))
    low, high = (read_sensor(f"{tmp_path / 'mine.toml'}@{iso}") for iso in (200, 800))
    assert (low.gain, high.gain) == pytest.approx((2.0, 8.0))
    assert (low.sigma_d, high.sigma_d) == pytest.approx((2.0, 4.0))
    assert (low.cfa, high.cfa) == ("GBRG", "RGGB")
    assert (low.sigma_row, high.sigma_row) == (0.5, 0.0)
    assert (low.sigma_column, high.sigma_column) == (0.0, 0.7)
    assert (low.mu_e_sat, high.mu_e_sat) == (inf, 8000.0)
    assert (low.dark_doubling, high.dark_doubling) == (6.0, inf)
    assert low.rgb_response == pytest.approx((0.5, 1.0, 0.7))
    assert high.rgb_response == pytest.approx((0.7, 1.0, 0.5))
    assert (low.rgb_bias, high.rgb_bias) == ((0.0, 0.0, 0.0), (1.0, 0.0, 2.0))
    assert (low.banding, high.banding) == (Banding(amplitude=2.0, period=9.0), None)
    assert (low.dual_gain, high.dual_gain) == (None, DualGain(threshold=500.0, sigma_d=9.0, ratio=8.0))
    assert low.optics == SensorOptics(falloff=(1.0, 0.5), sensor_shape=(30, 40))
    assert high.optics == SensorOptics(falloff=(1.0, 0.75, 0.25))
    found = [(of.hot_fraction, of.hot_factor, of.rts_factor, of.rts_traps) for of in (low.defects, high.defects)]
    assert found == [pytest.approx((0.2, 10.0, 1.0, 1)), pytest.approx((0.4, 1.0, 3.0, 4))]


def test_every_part_of_every_camera_of_a_series_reads_back(tmp_path: Path) -> None:
    several = replace(A7S2[100], banding=Banding(amplitude=1.0, period=9.0), optics=SensorOptics(corner_angle=20.0))
    cameras = {100: several, 400: replace(A7S2[400], defects=Defects(hot_fraction=0.1, hot_factor=9.0))}
    write_sensor(tmp_path / "mine.toml", cameras)
    assert {iso: read_sensor(f"{tmp_path / 'mine.toml'}@{iso}") for iso in cameras} == cameras


def test_the_middle_of_both_maps_of_a_camera_is_read_back(tmp_path: Path) -> None:
    offset = np.arange(80, dtype=np.float32).reshape(8, 10)
    write_maps(tmp_path / "mine.npz", Measured(offset=offset, response=1 + offset))
    found = read_maps(tmp_path / "mine.npz", (4, 6))
    np.testing.assert_array_equal(found.offset, offset[2:6, 2:8])
    np.testing.assert_array_equal(found.response, 1 + offset[2:6, 2:8])


@pytest.mark.parametrize("name", ["offset", "response"])
@pytest.mark.parametrize("damage", [lambda array: array[:, :-1], lambda array: array * np.inf])
def test_a_map_that_is_not_whole_is_refused_whichever_it_is(damage: Any, name: str, tmp_path: Path) -> None:
    maps = dict.fromkeys(("offset", "response"), np.ones((8, 10)))
    np.savez(tmp_path / "mine.npz", **maps | {name: damage(maps[name])})
    with pytest.raises(ValueError, match="mine.npz: maps must be finite"):
        read_maps(tmp_path / "mine.npz", (4, 6))


@pytest.mark.parametrize("iso", ["50", "2000", "51200"])
def test_an_iso_outside_of_the_measured_ones_or_at_the_switch_is_refused(iso: str, tmp_path: Path) -> None:
    path = write(tmp_path / "mine.toml")
    with pytest.raises(ValueError, match=rf"mine.toml: ISO must be one of 100, .*, got {iso}: others may be behind"):
        read_camera(f"{path}@{iso}")


def test_a_file_of_several_isos_asks_for_one(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"ISO of this camera must be one of 100, 200, .*; write FILE.toml@ISO"):
        read_camera(write(tmp_path / "mine.toml"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[iso.100]", "[iso.fast]"), r"a table of \[iso\] must be named by a whole number, got 'fast'"),
        (("[iso.100]", "[iso.0]"), r"a table of \[iso\] must be named by a whole number, got '0'"),
        (("isos = [100.0, 1600.0]", "isos = [100.0]"), "isos"),
        (("slope = ", "slant = "), "slope"),
        (("sigma_row", "sigma_rows"), "did you mean 'sigma_row'"),
    ],
)
def test_a_wrong_entry_is_named(change: tuple, message: str, tmp_path: Path) -> None:
    path = write(tmp_path / "mine.toml")
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(ValueError, match=message) as error:
        read_camera(f"{path}@100")
    assert re.search("mine.toml", str(error.value))


def test_a_table_says_what_differs_from_the_preset_and_an_iso_from_both(tmp_path: Path) -> None:
    """Telegraph pixels of the preset stay beside hot ones of the file, at the ISO that has more of them too."""
    path, preset = tmp_path / "mine.toml", PRESETS["prime-95b"]
    tables = {"defects": "hot_fraction = 0.001\nhot_factor = 50.0", "iso.100": "gain = 2.0",
              "iso.200.defects": "hot_factor = 80.0"}  # fmt: skip
    path.write_text('preset = "prime-95b"\n' + "\n".join(f"[{name}]\n{text}" for name, text in tables.items()))
    for iso, factor, gain in ((100, 50.0, 2.0), (200, 80.0, preset.gain)):
        defects = replace(preset.defects, hot_fraction=0.001, hot_factor=factor)
        assert read_sensor(f"{path}@{iso}") == replace(preset, gain=gain, defects=defects)


def test_an_at_sign_elsewhere_is_part_of_a_name() -> None:
    assert split_iso("a@b/mine.toml") == ("a@b/mine.toml", None)
    assert split_iso("mine.toml@fast") == ("mine.toml@fast", None)
    assert split_iso("a@b/mine.toml@3200") == ("a@b/mine.toml", 3200.0)
