"""DNG files, read back by LibRaw: every code, both levels, pattern, white balance and colour."""

import struct
from dataclasses import replace

import numpy as np
import pytest
import rawpy

from sensor_model import PRESETS, Exposure, develop, expose, mosaic, write_dng
from sensor_model.files.dng import SMALLEST, XYZ_TO_SRGB
from sensor_model.params import CFAS

EXPOSURE = Exposure(time=0.02)


def noise(sensor, shape=(31, 46)):
    """A frame that uses all codes from dark to saturated."""
    light = np.random.default_rng(0).random((*shape, 3)) ** 3 * 1.5 * sensor.capacity_e / sensor.eta
    return expose(mosaic(light, sensor.cfa) if sensor.cfa else light, sensor, EXPOSURE, seed=0, view=0).dn


@pytest.mark.parametrize("cfa", CFAS)
@pytest.mark.parametrize("name", ["imx900-lcg", "a7s2-iso6400", "imx686-iso1600", "ideal"])
def test_a_mosaic_comes_back_bit_for_bit_with_levels_pattern_and_white_balance(name, cfa, tmp_path):
    sensor = replace(PRESETS[name], cfa=cfa)
    dn = noise(sensor)
    write_dng(tmp_path / "a.dng", dn, sensor, EXPOSURE)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, dn)
        assert raw.black_level_per_channel == [sensor.black_level] * 4
        assert raw.white_level == int(sensor.white_dn)
        letters = "".join(chr(raw.color_desc[i]) for i in raw.raw_pattern.ravel())
        assert letters == cfa
        balance = np.array(raw.camera_whitebalance[:3])
        np.testing.assert_allclose(balance / balance[1], 1 / np.array(sensor.rgb_response), rtol=1e-4)


def test_three_chips_come_back_bit_for_bit_as_linear_raw(tmp_path):
    sensor = PRESETS["imx900-hcg-3chip"]
    dn = noise(sensor)
    write_dng(tmp_path / "a.dng", dn, sensor, EXPOSURE)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible[..., :3], dn)
        assert raw.black_level_per_channel == [240] * 4
        assert raw.white_level == int(sensor.white_dn)


@pytest.mark.parametrize("name", ["imx900-hcg-3chip", "a7s2-iso6400-3chip"])
@pytest.mark.parametrize("brightest", [1.0, 0.6])
def test_white_and_grey_of_three_chips_have_the_codes_they_should_in_another_converter(name, brightest, tmp_path):
    """LibRaw's own rendering, linear: whether the frame saturates or not, black is 0, white 65535, grey its share."""
    sensor = PRESETS[name]
    response = np.array(sensor.rgb_response) / max(sensor.rgb_response)
    span = int(sensor.white_dn) - sensor.black_level
    shares = np.repeat([[brightest, brightest, brightest], 0.25 * response, [0, 0, 0]], 20, axis=0)
    dn = np.broadcast_to(np.round(sensor.black_level + span * shares), (30, 60, 3)).astype(np.uint16)
    write_dng(tmp_path / "a.dng", dn.copy(), sensor, EXPOSURE)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        picture = raw.postprocess(
            use_camera_wb=True, no_auto_bright=True, adjust_maximum_thr=0.0, gamma=(1, 1), output_bps=16,
            output_color=rawpy.ColorSpace.raw,
        )  # fmt: skip
    assert picture[15, 50].tolist() == [0, 0, 0]
    np.testing.assert_allclose(picture[15, 30] / 65535, 0.25, rtol=2e-3)
    expected = np.minimum(brightest / response, 1)  # balanced, and clipped
    np.testing.assert_allclose(picture[15, 10] / 65535, expected, rtol=2e-3)


def test_a_monochrome_frame_comes_back_bit_for_bit(tmp_path):
    sensor = PRESETS["prime-95b"]
    dn = noise(sensor)[..., 0].copy()
    write_dng(tmp_path / "a.dng", dn, sensor, EXPOSURE)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, dn)
        assert raw.black_level_per_channel[0] == 100
    assert [p.name for p in tmp_path.iterdir()] == ["a.dng"]


def test_another_raw_converter_renders_the_colours_we_render(tmp_path):
    """Rationale: levels, white balance and colour matrix are right only if a stranger's pipeline agrees with ours."""
    sensor = replace(PRESETS["imx900-hcg"], sigma_d=0.0, dsnu=0.0, prnu=0.0, dark_current=0.0)
    patches = np.random.default_rng(1).uniform(0.05, 0.9, (4, 6, 3))
    light = np.kron(patches, np.ones((32, 32, 1))) * sensor.rgb_response * sensor.capacity_e * 0.9 / sensor.eta
    frame = expose(mosaic(light, sensor.cfa), sensor, EXPOSURE, seed=0, view=0, shot="none")
    write_dng(tmp_path / "a.dng", frame.dn, sensor, EXPOSURE)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        theirs = raw.postprocess(
            use_camera_wb=True,
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            gamma=(2.4, 12.92),
            user_flip=0,
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
        )
    ours = develop(frame, sensor, demosaic="bilinear").srgb8
    middle = (slice(16, None, 32),) * 2
    assert np.abs(theirs[middle].astype(int) - ours[middle]).max() <= 1


def test_another_raw_converter_knows_filters_that_are_not_those_of_srgb(tmp_path):
    """Camera RGB = filters x sRGB: the picture of a stranger's pipeline is ours with the inverse as colour matrix."""
    filters = np.array([[0.7, 0.2, 0.1], [0.1, 0.8, 0.1], [0.05, 0.15, 0.8]])  # white stays (1, 1, 1)
    response = np.array([0.6, 1.0, 0.8])
    sensor = replace(PRESETS["imx900-hcg"], sigma_d=0.0, dsnu=0.0, prnu=0.0, dark_current=0.0)
    sensor = replace(sensor, rgb_response=tuple(response))
    patches = np.random.default_rng(1).uniform(0.2, 0.7, (4, 6, 3))
    light = np.kron(patches @ filters.T, np.ones((32, 32, 1))) * response * sensor.capacity_e * 0.9 / sensor.eta
    frame = expose(mosaic(light, sensor.cfa), sensor, EXPOSURE, seed=0, view=0, shot="none")
    matrix = np.linalg.inv(filters)
    write_dng(tmp_path / "a.dng", frame.dn, sensor, EXPOSURE, color_matrix=matrix)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        theirs = raw.postprocess(
            use_camera_wb=True, no_auto_bright=True, adjust_maximum_thr=0.0, gamma=(2.4, 12.92), user_flip=0,
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
        )  # fmt: skip
    ours = develop(frame, sensor, demosaic="bilinear", color_matrix=matrix).srgb8
    middle = (slice(16, None, 32),) * 2
    assert np.abs(theirs[middle].astype(int) - ours[middle]).max() <= 2


def test_the_colour_matrix_is_that_of_colour_science():
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its optional parts warn when they are not there
        import colour
    np.testing.assert_allclose(colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB, XYZ_TO_SRGB, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "dn", "message"),
    [
        ("imx900-hcg", np.zeros((4, 4, 3), np.uint16), "dn must be"),
        ("imx900-hcg", np.zeros((4, 4), np.float32), "uint16"),
        ("imx900-hcg-3chip", np.zeros((4, 4, 2), np.uint16), "dn must be"),
    ],
)
def test_what_does_not_fit_the_camera_is_refused(name, dn, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        write_dng(tmp_path / "a.dng", dn, PRESETS[name], EXPOSURE)
    assert not list(tmp_path.iterdir())


def rationals(path, tag):
    """Numerators and denominators of a tag of type RATIONAL (5), [n, 2]."""
    data = path.read_bytes()
    _, _, count, where = struct.unpack_from("<HHII", data, data.index(struct.pack("<HH", tag, 5)))
    return np.frombuffer(data, "<u4", 2 * count, where).reshape(count, 2).astype(float)


@pytest.mark.parametrize("cfa", ["RGGB", None])
def test_a_black_level_between_two_codes_stays_exact_in_the_file(cfa, tmp_path):
    """Rationale: measured cameras have such levels. LibRaw itself takes a whole number beside it."""
    sensor = replace(PRESETS["imx900-hcg"], black_level=240.375, cfa=cfa)
    write_dng(tmp_path / "a.dng", noise(sensor), sensor, EXPOSURE)
    levels = rationals(tmp_path / "a.dng", 50714)
    assert set(levels[:, 0] / levels[:, 1]) == {240.375}
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        assert abs(raw.black_level_per_channel[0] - 240.375) < 1


@pytest.mark.parametrize("black", [0.0, 5000.0, 5000 + 1 / 3, 60_000.5])
@pytest.mark.parametrize("time", [0.0, 1e-9, 1e-7, 1 / 3, 0.02, 5000.0, 86_400.0, 2e9])
def test_any_black_level_and_exposure_time_fit_the_rationals_of_the_file(black, time, tmp_path):
    sensor = replace(PRESETS["imx900-hcg"], bits=16, black_level=black)
    write_dng(tmp_path / "a.dng", np.zeros((16, 16), np.uint16), sensor, Exposure(time=time))
    for tag, value in ((50714, black), (33434, time)):
        found = rationals(tmp_path / "a.dng", tag)
        assert found[0, 0] / found[0, 1] == pytest.approx(value, rel=1e-8)


@pytest.mark.parametrize("time", [1e-10, 1e10])
def test_a_time_no_rational_of_the_file_holds_is_refused(time, tmp_path):
    with pytest.raises(ValueError, match="time must be"):
        write_dng(tmp_path / "a.dng", np.zeros((16, 16), np.uint16), PRESETS["imx900-hcg"], Exposure(time=time))


@pytest.mark.parametrize("name", ["imx900-hcg", "prime-95b", "imx900-hcg-3chip"])
def test_the_smallest_side_is_the_smallest_that_libraw_takes(name, tmp_path):
    """Rationale: nobody can read a smaller file back, and LibRaw calls it "not RAW" without a word on the size."""
    three = (3,) if name.endswith("3chip") else ()
    for height, width in ((SMALLEST, SMALLEST), (SMALLEST, 65), (65, SMALLEST)):
        dn = np.arange(height * width * 3, dtype=np.uint16)[: height * width * (3 if three else 1)]
        dn = dn.reshape(height, width, *three)
        write_dng(tmp_path / "a.dng", dn, PRESETS[name], EXPOSURE)
        with rawpy.imread(str(tmp_path / "a.dng")) as raw:
            visible = raw.raw_image_visible
            np.testing.assert_array_equal(visible[..., :3] if three else visible, dn)
    for height, width in ((SMALLEST - 1, 65), (65, SMALLEST - 1)):
        write_dng(tmp_path / "a.dng", np.zeros((height, width, *three), np.uint16), PRESETS[name], EXPOSURE)
        with pytest.raises(rawpy.LibRawFileUnsupportedError):
            rawpy.imread(str(tmp_path / "a.dng"))


def count(path, tag, kind):
    """Number of values of a tag of this type."""
    data = path.read_bytes()
    return struct.unpack_from("<I", data, data.index(struct.pack("<HH", tag, kind)) + 4)[0]


@pytest.mark.parametrize("name", ["imx900-hcg", "prime-95b", "imx900-hcg-3chip"])
def test_levels_are_one_number_for_all_channels(name, tmp_path):
    """Of three channels DNG 1.4 wants three of each, with which LibRaw renders the picture too dark."""
    dn = noise(PRESETS[name]) if name != "prime-95b" else noise(PRESETS[name])[..., 0].copy()
    write_dng(tmp_path / "a.dng", dn, PRESETS[name], EXPOSURE)
    black, white = (50714, 5), (50717, 3)  # RATIONAL, SHORT
    assert count(tmp_path / "a.dng", *black) == 1
    assert count(tmp_path / "a.dng", *white) == 1


def test_a_camera_whose_white_would_be_its_black_in_the_file_is_refused(tmp_path):
    dim = replace(PRESETS["ideal"], gain=1e-3, mu_e_sat=100.0, black_level=64.0)  # 0.1 DN
    with pytest.raises(ValueError, match=r"white in a DNG must be over black, 64 DN, got 64; raise gain or mu_e_sat"):
        write_dng(tmp_path / "a.dng", np.zeros((30, 30), np.uint16), dim, EXPOSURE)
    assert not list(tmp_path.iterdir())
    write_dng(tmp_path / "a.dng", np.zeros((30, 30), np.uint16), replace(dim, gain=0.01), EXPOSURE)
