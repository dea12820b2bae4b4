"""Claims about cameras measured from folders of frames: the simulated camera that took them is found again."""

import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from novags.testbed.importing.calibration import frames as calibration
from novags.testbed.importing.calibration.camera import characterise_folder as all_of
from novags.testbed.importing.calibration.frames import read_frames
from sensor_model import PRESETS, Exposure, Sensor, expose, mosaic, read_sensor, write_dng

MONO = Sensor(
    gain=0.9, eta=0.55, mu_e_sat=4000.0, black_level=60.4, bits=12, sigma_d=3.0, dsnu=1.5, prnu=0.01,
    dark_current=20.0, nonlinearity=0.02, cfa=None, serial=5,
)  # fmt: skip
BAYER = replace(PRESETS["imx900-hcg"], cfa="GBRG", dark_current=30.0, rgb_response=(0.5, 1.0, 0.7), rgb_bias=(3, 0, -2))
TIMES = np.array([0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 1.2])  # of the time to full well


def write_frames(folder: Path, sensor: Sensor, save, shape=(160, 200), middle: int = 12) -> dict[str, tuple]:
    """Dark and flat stacks; returns the time and photons of each."""
    taken = {}
    rate = sensor.mu_e_sat / sensor.eta  # photons per second: full well at 1 s
    for kind in ("dark", "flat"):
        for i, time in enumerate(TIMES):
            name, photons = f"{kind}/{i}", rate * time * (kind == "flat")
            colour = np.broadcast_to(photons * np.asarray(sensor.rgb_response), (*shape, 3))
            light = mosaic(colour, sensor.cfa) if sensor.cfa else colour[..., 0]
            (folder / name).mkdir(parents=True)
            exposure = Exposure(time=time)
            for n in range(middle if i == 3 else 2):
                frame = expose(light, sensor, exposure, seed=100 * i + (kind == "flat"), view=0, frame=n)
                save(folder / name / f"{n:02d}", frame.dn, sensor, exposure)
            taken[name] = (time, photons)
    return taken


def as_dng(path: Path, dn: np.ndarray, sensor: Sensor, exposure: Exposure) -> None:
    write_dng(path.with_suffix(".dng"), dn, sensor, exposure)


def as_png(path: Path, dn: np.ndarray, *_: object) -> None:
    cv2.imwrite(str(path.with_suffix(".png")), dn)


def as_npy(path: Path, dn: np.ndarray, *_: object) -> None:
    np.save(path.with_suffix(".npy"), dn)


def as_tiff_with_exif(path: Path, dn: np.ndarray, _: Sensor, exposure: Exposure) -> None:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[34665] = {33434: TiffImagePlugin.IFDRational(round(exposure.time * 10_000), 10_000)}
    Image.fromarray(dn).save(path.with_suffix(".tiff"), tiffinfo=tags)


def characterise_folder(folder: Path) -> tuple[Sensor, Any]:
    """At one setting."""
    (one,) = all_of(folder).settings.values()
    return one.sensor, one.found


def write_notes(folder: Path, taken: dict[str, tuple], head: str, *, photons: bool = True, times: bool = True) -> None:
    lines = [head]
    for name, (time, light) in taken.items():
        lines += [
            f'[stacks."{name}"]',
            *([f"time = {time}"] if times else []),
            *([f"photons = {light}"] if photons else []),
        ]
    (folder / "frames.toml").write_text("\n".join(lines))


def assert_found(found: Sensor, sensor: Sensor, **tolerances: float) -> None:
    for field, tolerance in tolerances.items():
        assert getattr(found, field) == pytest.approx(getattr(sensor, field), rel=tolerance), field
    assert found.bits == sensor.bits
    assert found.cfa == sensor.cfa


@pytest.mark.parametrize("save", [as_png, as_npy, as_tiff_with_exif])
def test_a_monochrome_camera_is_found_in_images_of_every_kind(save, tmp_path: Path) -> None:
    taken = write_frames(tmp_path, MONO, save)
    write_notes(tmp_path, taken, "bits = 12", times=save is not as_tiff_with_exif)
    found, _ = characterise_folder(tmp_path)
    assert_found(found, MONO, gain=0.015, eta=0.015, mu_e_sat=0.015, sigma_d=0.03, dark_current=0.05, dsnu=0.05)
    assert_found(found, MONO, prnu=0.04)
    assert found.black_level == pytest.approx(MONO.black_level, abs=0.2)
    assert found.nonlinearity == pytest.approx(MONO.nonlinearity, abs=0.004)


def test_a_colour_camera_is_found_in_raw_files_and_takes_pictures(tmp_path: Path, call, capsys) -> None:
    """Rationale: the whole way of a user, from his raw files to `--sensor`. Exposure times, pattern and bits: EXIF."""
    write_frames(tmp_path / "frames", BAYER, as_dng)
    (tmp_path / "frames" / "frames.toml").write_text("bits = 12\n[camera]\neta = 0.8847\nserial = 7\n")
    out = tmp_path / "new" / "camera.toml"
    assert call("characterise", str(tmp_path / "frames"), "--out", str(out)) == 0
    assert "gain 1.6" in capsys.readouterr().out
    found = read_sensor(out)
    assert_found(found, BAYER, gain=0.02, mu_e_sat=0.02, sigma_d=0.04, dark_current=0.05, dsnu=0.08, prnu=0.08)
    np.testing.assert_allclose(found.rgb_response, BAYER.rgb_response, rtol=0.01)
    np.testing.assert_allclose(found.rgb_bias, BAYER.rgb_bias, atol=0.2)
    assert found.serial == 7
    assert expose(np.full((8, 8), 20.0), found, Exposure(time=0.1), seed=0, view=0).dn.shape == (8, 8)


def test_only_the_middle_is_read_and_keeps_its_pattern(tmp_path: Path) -> None:
    write_frames(tmp_path, BAYER, as_dng, shape=(90, 102), middle=2)
    (tmp_path / "frames.toml").write_text("bits = 12\n")
    whole, part = read_frames(tmp_path), read_frames(tmp_path, 40)
    assert part.cfa == "GBRG"
    assert part.flat[0].frames.shape == (2, 40, 40)
    np.testing.assert_array_equal(part.flat[4].frames, whole.flat[4].frames[:, 24:64, 30:70])
    assert [s.time for s in part.dark] == pytest.approx(list(TIMES))


@pytest.mark.parametrize(
    ("notes", "message"),
    [
        ("TIMES bits", "do not state their bits: give in frames.toml bits = N$"),
        ("bits = 12", r'exposure times: give in frames.toml \[stacks."dark/0"\] and below it time = SECONDS; \[stacks'),
        ('bits = 12\n[stacks."dark/0"]\nphotons = 3.0', r'exposure times: give in frames.toml \[stacks."dark/0"\]'),
        ("", r'their bits and exposure times: give in frames.toml bits = N; .*\[stacks."dark/4"\] .*"flat/0"\] and'),
        ("bits = 12\nlens = 3", "unknown lens"),
        ("bits = ", "frames.toml"),
        ('bits = 12\n[stacks."dark/9"]\ntime = 1.0', "stacks that are not there: dark/9"),
        ("TIMES", "does not determine eta: give the photons"),
        ("TIMES\n[camera]\neta = 60", r"frames.toml: eta must be in \(0, 1\]"),
        ("TIMES\n[camera]\neta = 0.5\nsigma_read = 1", "got 'sigma_read'"),
    ],
)
def test_what_a_folder_does_not_tell_is_asked_for(notes: str, message: str, tmp_path: Path) -> None:
    taken = write_frames(tmp_path, MONO, as_npy, shape=(16, 16), middle=2)
    if notes.startswith("TIMES"):
        write_notes(tmp_path, taken, "" if notes == "TIMES bits" else "bits = 12" + notes[5:], photons=False)
    else:
        (tmp_path / "frames.toml").write_text(notes)
    with pytest.raises(ValueError, match=message):
        characterise_folder(tmp_path)


def test_folders_that_are_laid_out_otherwise_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="needs a folder dark/"):
        read_frames(tmp_path)
    write_notes(tmp_path, write_frames(tmp_path, MONO, as_npy, shape=(16, 16), middle=2), "bits = 12")
    np.save(tmp_path / "flat" / "0" / "zz.npy", np.zeros((2, 9, 16), np.uint16))
    with pytest.raises(ValueError, match="frames of one size"):
        read_frames(tmp_path)
    np.save(tmp_path / "flat" / "0" / "zz.npy", np.zeros((16, 16), np.float32))
    with pytest.raises(ValueError, match="integer codes of one channel"):
        read_frames(tmp_path)


LIGHT = np.random.default_rng(0).poisson(1200, (6, 48, 64)) + 64


def write_stacks(folder: Path, save, change=lambda dn: dn, bits: int = 12, more: str = "") -> None:
    """A dark and a flat stack; `save` gets the folder of a stack and its codes [n,h,w]."""
    for name, codes in (("dark/0", LIGHT // 20), ("flat/0", LIGHT)):
        (folder / name).mkdir(parents=True)
        changed = change(codes)
        save(folder / name, changed if changed.dtype == np.uint8 else changed.astype(np.uint16))
    lines = [f"bits = {bits}", more, *(f'[stacks."{name}"]\ntime = 1.0' for name in ("dark/0", "flat/0"))]
    (folder / "frames.toml").write_text("\n".join(lines))


def one_npy(place: Path, codes: np.ndarray) -> None:
    np.save(place / "a.npy", codes)


@pytest.mark.parametrize(
    ("change", "bits", "message"),
    [
        (
            lambda dn: dn << 4,
            12,
            r"flat/0 must be at most 4095 by the 12 bits .* multiples of 16: .* top by 4 bits; "
            "divide",
        ),  # fmt: skip
        (
            lambda dn: dn << 4,
            16,
            r"whole numbers without gaps by the 16 bits .* multiples of 16: .* bits that are "
            "left",
        ),  # fmt: skip
        (lambda dn: dn << 2, 14, r"multiples of 4: they are probably shifted to the top by 2 bits; divide them by 4"),
        (lambda dn: dn << 6, 16, r"at most 65535 .*|multiples of 64"),
        (
            lambda dn: np.round(dn * (65535 / 4095)),
            16,
            r"none are closer together than 16: .* stretched from fewer "
            "bits",
        ),  # fmt: skip
        (lambda dn: dn * 5, 12, r"must be at most 4095 by the 12 bits"),
        (lambda dn: dn, 10, r"must be at most 1023 by the 10 bits .* probably those of another mode"),
        (
            lambda dn: dn * (1 + np.indices((48, 64)).sum(0) % 2),
            12,
            r'behind .* colour filters; give cfa = "',
        ),
        (
            lambda dn: (dn // 16).astype(np.uint8),
            12,
            "hold 8 bits, and 12 are stated: the lowest were probably cut off",
        ),
        (lambda dn: dn[[0, 1, 0]], 12, "frames 1 and 3 of .*/flat/.* are the same, and light never is"),
    ],
)
def test_codes_that_do_not_fit_their_bits_are_refused_with_the_likely_cause(
    change, bits: int, message: str, tmp_path: Path
) -> None:
    write_stacks(tmp_path, one_npy, change, bits)
    with pytest.raises(ValueError, match=message):
        read_frames(tmp_path)


def with_iso(place: Path, iso: int) -> None:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[34665] = {34855: iso}
    Image.fromarray(np.load(place / "a.npy")[0] + np.uint16(1)).save(place / f"{iso}.tiff", tiffinfo=tags)


@pytest.mark.parametrize(("name", "dark", "flat", "wrong"), [
    ("frames", 3200, 3200, ""), ("iso3200", 3200, 3200, ""), ("iso102400", 65535, 65535, ""),
    ("frames", 3200, 100, "100.tiff states the ISO speed 100, .*dark.0.3200.tiff 3200"),
    ("iso3200", 100, 100, "100.tiff states the ISO speed 100, the name of the folder 3200"),
])  # fmt: skip
def test_all_frames_are_of_one_iso_and_of_the_one_of_their_folder(
    name: str, dark: int, flat: int, wrong: str, tmp_path: Path
) -> None:
    """Rationale: the gain by the rule, 0.1 DN/e- at ISO 100, was the folder's; flat frames of ISO 100 went unseen."""
    write_stacks(tmp_path / name, one_npy)
    with_iso(tmp_path / name / "dark" / "0", dark)
    with_iso(tmp_path / name / "flat" / "0", flat)
    if wrong:
        with pytest.raises(ValueError, match=f"{wrong}: dark and flat frames must be of the camera's one ISO"):
            read_frames(tmp_path / name)
    else:
        assert read_frames(tmp_path / name).iso == (102400 if dark == 65535 else dark)


@pytest.mark.parametrize(("read_noise", "said"), [(0.1, True), (0.2, True), (0.5, False), (3.0, False)])
def test_noise_below_a_code_is_said(read_noise: float, said: bool, tmp_path: Path) -> None:
    """In DN, at a black level whose noise falls on two codes."""
    noise = np.random.default_rng(0).normal(64.5, read_noise, LIGHT.shape)
    write_stacks(tmp_path, one_npy, lambda dn: np.floor(noise) if dn.mean() < 100 else dn)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_frames(tmp_path)
    assert ["its noise is below a code" in str(w.message) for w in caught] == [True] * said


@pytest.mark.parametrize("still", [0, 1])
def test_noise_below_a_code_in_one_of_several_dark_stacks_is_said(still: int, tmp_path: Path) -> None:
    write_stacks(tmp_path, one_npy, more='[stacks."dark/1"]\ntime = 2.0')
    (tmp_path / "dark" / "1").mkdir()
    for k in range(2):
        noise = np.random.default_rng(k).normal(64.5, 0.1 if k == still else 3.0, LIGHT.shape)
        one_npy(tmp_path / "dark" / f"{k}", np.floor(noise).astype(np.uint16))
    with pytest.warns(UserWarning, match="its noise is below a code"):
        read_frames(tmp_path)


@pytest.mark.parametrize("said", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_filters_that_are_said_a_row_or_a_column_beside_are_refused(said: str, tmp_path: Path) -> None:
    """Behind RGGB, which codes alone do not tell from BGGR; green would be measured as red or blue."""
    filters = np.tile([[0.5, 1.0], [1.0, 0.7]], (24, 32))
    write_stacks(tmp_path, one_npy, lambda dn: 64 + (dn - 64.0).clip(0) * filters, more=f'cfa = "{said}"')
    if said[0] != "G":
        assert read_frames(tmp_path).cfa == said
    else:
        with pytest.raises(ValueError, match=f"behind the filters {said}, .* they lie a row or a column beside"):
            read_frames(tmp_path)


def pages(place: Path, codes: np.ndarray) -> None:
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(place / "a.tif", codes, photometric="minisblack")


def imagej(place: Path, codes: np.ndarray) -> None:
    tifffile = pytest.importorskip("tifffile")
    for half in (0, 1):
        tifffile.imwrite(place / f"{half}.tif", codes[half * 3 : half * 3 + 3], imagej=True)


def three_samples(place: Path, codes: np.ndarray) -> None:
    for i, frame in enumerate(codes):
        cv2.imwrite(str(place / f"{i}.png"), np.dstack([frame] * 3))


@pytest.mark.parametrize("save", [pages, imagej, three_samples, one_npy])
def test_all_frames_of_a_file_are_read(save, tmp_path: Path) -> None:
    """Rationale: only the first page of each file was read. Programs of gray cameras write three equal samples."""
    write_stacks(tmp_path, save)
    np.testing.assert_array_equal(read_frames(tmp_path).flat[0].frames, LIGHT)


@pytest.mark.parametrize(
    ("save", "message"),
    [
        (
            lambda place, dn: np.savez(place / "a.npz", dn),
            r"got files of other kinds \(a.npz\): convert them to 16-bit "
            "TIFF",
        ),  # fmt: skip
        (lambda place, dn: (place / "a.fits").write_bytes(b"SIMPLE"), r"other kinds \(a.fits\)"),
        (lambda place, dn: (place / "notes.txt").write_text("none"), "got no frames"),
        (lambda place, dn: (one_npy(place, dn), (place / "b.raw").touch()), r"other kinds \(b.raw\)"),
        (lambda place, dn: np.save(place / "a.npy", dn[..., None].repeat(3, -1)[0] + np.arange(3)), "may be channels"),
        (
            lambda place, dn: np.save(place / "a.npy", dn.astype(np.float32)),
            "integer codes of one channel, got float32",
        ),  # fmt: skip
    ],
)
def test_files_that_hold_no_frames_are_named(save, message: str, tmp_path: Path) -> None:
    write_stacks(tmp_path, save)
    with pytest.raises(ValueError, match=message):
        read_frames(tmp_path)


@pytest.mark.parametrize("odd", range(3))
def test_every_frame_of_a_stack_counts_in_its_size_and_its_time(odd: int) -> None:
    files = [calibration.CalibrationFrame(np.full((2, 10, 12), k, np.uint16), 0.5) for k in range(3)]
    found = calibration._stack(Path("dark/a"), files, {"photons": 3.0})
    assert found.frames.shape == (6, 10, 12)
    assert [found.frames[2 * k].max() for k in range(3)] == [0, 1, 2]
    assert (found.time, found.photons) == (0.5, 3.0)
    smaller = [replace(file, dn=file.dn[:, :8]) if k == odd else file for k, file in enumerate(files)]
    with pytest.raises(ValueError, match="frames of one size"):
        calibration._stack(Path("dark/a"), smaller, {})
    longer = [replace(file, time=0.75) if k == odd else file for k, file in enumerate(files)]
    with pytest.raises(ValueError, match="differ in exposure time: 0.5, 0.75"):
        calibration._stack(Path("dark/a"), longer, {})


def test_colours_are_those_of_all_stacks_below_saturation() -> None:
    """Red has half of green's response and a black level of its own; the last flat stack is clipped."""
    response, black, rise = np.array([0.5, 1.0, 0.25]), np.array([102.0, 100.0, 97.0]), 8.0
    kinds = np.array([[0, 1], [1, 2]])

    def stack(time: float, light: float) -> Any:
        cell = black[kinds] + rise * time + np.minimum(light * response[kinds], 4000.0)
        return calibration.Stack(np.tile(cell, (2, 8, 8)), time, None)

    frames: Any = SimpleNamespace(cfa="RGGB", dark=[stack(t, 0.0) for t in (0.0, 1.0, 4.0)],
                                  flat=[stack(1.0, light) for light in (400.0, 800.0, 9000.0)])  # fmt: skip
    found = calibration.colours(frames)
    assert found["rgb_response"] == pytest.approx(response.tolist(), rel=1e-6)
    assert found["rgb_bias"] == pytest.approx((black - black[1]).tolist(), abs=1e-6)
