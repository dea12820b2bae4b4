"""Claims about scores of pictures from anywhere: every kind of file, the right reference, nothing wrong believed."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.importing.pictures import read_picture
from novags.testbed.metrics.images import image_scores
from novags.testbed.stages.scores.foreign import Truth, score_renders
from sensor_model import srgb_to_linear
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.exr import write_exr
from simscenes.sets.pictures.png import read_png, write_png

QUIET = Console(quiet=True)
TEST = ("0000", "0008")
NAMES = [f"{i:04d}" for i in range(9)]


def score(renders: Path, where: Path, reference: str = "lit") -> dict:
    return score_renders(renders, Truth.of(where, QUIET), reference, QUIET)  # type: ignore[arg-type]


def pictures(photographs: Path, folder: Path, kind: str, shift: float = 0.05) -> Path:
    """The lit views of the test views, a little brighter, as files of a kind."""
    folder.mkdir()
    for name in TEST:
        shown = np.clip(read_png(photographs / "images" / f"{name}.png") + shift, 0, 1)
        if kind == "EXR":
            write_exr(folder / f"{name}.exr", {c: np.ascontiguousarray(shown[..., k]) for k, c in enumerate("RGB")})
        elif kind == "16-bit":
            write_png(folder / f"{name}.png", np.round(shown * 65535).astype(np.uint16))
        elif kind == "16-bit TIFF":
            cv2.imwrite(str(folder / f"{name}.tif"), np.round(shown * 65535).astype(np.uint16)[..., ::-1])
        else:
            write_png(folder / f"{name}.png", shown)
    return folder


@pytest.mark.parametrize("kind", ["8-bit", "16-bit", "16-bit TIFF", "EXR"])
def test_pictures_of_every_kind_score_as_their_values_do(photographs: Path, tmp_path: Path, kind: str) -> None:
    found = score(pictures(photographs, tmp_path / "mine", kind), photographs)
    lit = [read_png(photographs / "images" / f"{name}.png") for name in TEST]
    expected = [image_scores(np.clip(picture + 0.05, 0, 1).astype(np.float32), picture) for picture in lit]
    for name, scores in zip(TEST, expected, strict=True):
        assert found["views"][name]["lit"]["psnr"] == pytest.approx(scores["psnr"], abs=0.3)  # of rounding to 8 bits
    assert found["mean"]["lit"]["ssim"] == pytest.approx(np.mean([s["ssim"] for s in expected]), abs=1e-3)
    assert found["about"]["pictures"] == [kind[:6].strip()]


@pytest.mark.parametrize("name", ["alpha", "A"])
def test_the_opacity_of_an_exr_file_is_its_channel_alpha_or_a(tmp_path: Path, name: str) -> None:
    plane = np.full((4, 6), 0.25, np.float32)
    write_exr(tmp_path / "a.exr", {**dict.fromkeys("RGB", plane), "Z": 2 * plane, name: 3 * plane})
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr", 6, 4).alpha, 0.75)


def test_a_capture_has_the_light_and_the_noise_free_exposure_too(capture: Path, tmp_path: Path) -> None:
    truth = Truth.of(capture, QUIET)
    clean, linear = truth.reader("clean"), truth.reader("linear")
    for kind, values in (("clean", clean), ("linear", lambda i: 3.0 * linear(i))):
        for name, i in zip(truth.names, truth.indices, strict=True):
            shown = values(i).astype(np.float32)
            planes = {c: np.ascontiguousarray(shown[..., k]) for k, c in enumerate("RGB")}
            write_exr(tmp_path / kind / f"{name}.exr", planes)
    assert score(tmp_path / "clean", capture, "clean")["mean"]["clean"]["psnr"] > 90
    found = score(tmp_path / "linear", capture, "linear")
    assert found["about"]["gain"] == pytest.approx(1 / 3, rel=1e-4)
    assert found["mean"]["linear"]["linear_psnr"] > 90
    assert score(tmp_path / "clean", capture, "lit")["mean"]["lit"]["psnr"] < 40


def test_eight_bits_are_decoded_for_linear_light_and_sixteen_are_not(photographs: Path, tmp_path: Path) -> None:
    eight = pictures(photographs, tmp_path / "eight", "8-bit", shift=0.0)
    assert score(eight, photographs, "linear")["mean"]["linear"]["linear_psnr"] > 60
    (tmp_path / "sixteen").mkdir()
    for name in TEST:
        light = srgb_to_linear(read_png(photographs / "images" / f"{name}.png"))
        write_png(tmp_path / "sixteen" / f"{name}.png", np.round(light * 65535).astype(np.uint16))
    assert score(tmp_path / "sixteen", photographs, "linear")["mean"]["linear"]["linear_psnr"] > 60


WRONG = {
    "one missing": (lambda f: (f / "0008.png").unlink(), "lacks 1 of the 2 test views: 0008; it holds 0000: name"),
    "none": (lambda f: [p.unlink() for p in f.iterdir()], "lacks 2 of the 2 test views: 0000, 0008; it holds no pict"),
    "two of one": (lambda f: shutil.copy(f / "0000.png", f / "0000.jpg"), r"more than one picture of view 0000 \(0000"),
    "size": (lambda f: write_png(f / "0000.png", np.zeros((24, 33, 3))), "0000.png is 33 x 24 px, and its view 32 x"),
    "no picture": (lambda f: (f / "0000.png").write_text("hello"), "0000.png is not a readable image"),
    "nan": (
        lambda f: ((f / "0000.png").unlink(), write_exr(
            f / "0000.exr", {c: np.full((24, 32), np.nan, np.float32) for c in "RGB"})),
        "0000.exr: a value is not finite",
    ),
    "grey exr": (
        lambda f: ((f / "0000.png").unlink(), write_exr(f / "0000.exr", {"Y": np.zeros((24, 32), np.float32)})),
        "0000.exr lacks the channels R, G, B, it has Y",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_what_cannot_be_scored_is_one_line_that_names_it(photographs: Path, tmp_path: Path, what: str) -> None:
    damage, said = WRONG[what]
    folder = pictures(photographs, tmp_path / "mine", "8-bit")
    damage(folder)
    with pytest.raises(ValueError, match=said) as error:
        score(folder, photographs)
    assert len(str(error.value).splitlines()) == 1


def test_references_that_there_are_not_are_refused(photographs: Path, tmp_path: Path) -> None:
    folder = pictures(photographs, tmp_path / "mine", "8-bit")
    with pytest.raises(ValueError, match="the reference clean is of a dark capture, and .*photos is a set"):
        score(folder, photographs, "clean")
    with pytest.raises(ValueError, match="does not exist"):
        score(folder, tmp_path / "nowhere")


def test_the_command_says_what_was_compared_with_what(
    photographs: Path, tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = pictures(photographs, tmp_path / "mine", "16-bit")
    shutil.copy(folder / "0000.png", folder / "0003.png")  # a training view
    words = ("score", "--renders", str(folder), "--set", str(photographs), "--out", str(tmp_path / "scores.json"))
    assert call(*words) == 0
    said = capsys.readouterr()
    assert "2 test views, 16-bit pictures, against lit: the views in good light, sRGB" in said.out
    assert "1 pictures are of no test view and are left out (0003.png)" in said.err
    kept = json.loads((tmp_path / "scores.json").read_text())
    assert f"{kept['mean']['lit']['psnr']:.4f}" in said.out
    assert call(*words) == 2
    assert "is there already" in capsys.readouterr().err
    assert call("score", "--renders", str(folder)) == 2
    assert call("score") == 2


def test_light_of_a_set_with_colour_filters_of_its_own_is_compared_in_srgb(tmp_path: Path) -> None:
    """Expectation: the true linear sRGB of the scene, which the filters have seen, is exact."""
    filters, color = np.array([[0.5, 0.2, 0.1], [0.1, 0.8, 0.1], [0.0, 0.1, 0.5]]), np.array([0.8, 0.2, 0.1])
    write_cameras(tmp_path / "set", NAMES, orbit_rig(len(NAMES), 16, 12, 30.0, radius=3.0))
    ramp = np.linspace(0.2, 1, 12)[:, None, None] * np.ones((12, 16, 1))
    for name in NAMES:
        write_png(tmp_path / "set" / "images" / f"{name}.png", np.full((12, 16, 3), 200, np.uint8))
        for folder, light in (("set/gt", ramp * (filters @ color)), ("mine", ramp * color)):
            planes = {c: np.ascontiguousarray(light[..., k], np.float32) for k, c in enumerate("RGB")}
            write_exr(tmp_path / folder / f"{name}.exr", planes)
    meta = {"kind": "rendered", "camera_matrix": filters.tolist(), "exposure_scale": 1.0}
    (tmp_path / "set" / "set.json").write_text(json.dumps(meta))
    assert score(tmp_path / "mine", tmp_path / "set", "linear")["mean"]["linear"]["linear_psnr"] > 90


@pytest.mark.parametrize("exposure", [0.25, 3.0])
def test_the_light_of_a_set_is_that_of_its_exposure(exposure: float, tmp_path: Path) -> None:
    """Pictures that lie at the exposure of the set are exact, without any gain that fits them."""
    write_cameras(tmp_path / "set", NAMES, orbit_rig(len(NAMES), 16, 12, 30.0, radius=3.0))
    light = np.linspace(0.1, 0.3, 12)[:, None] * np.ones((12, 16))
    for name in NAMES:
        write_png(tmp_path / "set" / "images" / f"{name}.png", np.full((12, 16, 3), 200, np.uint8))
        write_exr(tmp_path / "set/gt" / f"{name}.exr", {c: np.ascontiguousarray(light, np.float32) for c in "RGB"})
    (tmp_path / "set" / "set.json").write_text(json.dumps({"kind": "rendered", "exposure_scale": exposure}))
    found = Truth.of(tmp_path / "set", QUIET).reader("linear")(0)
    np.testing.assert_allclose(found, np.float32(exposure * light)[..., None].repeat(3, -1), rtol=1e-6)


def test_the_views_that_count_are_all_held_out_ones_of_a_set_and_of_a_capture(photographs: Path, capture: Path) -> None:
    for folder in (photographs, capture):
        truth = Truth.of(folder, QUIET)
        assert (truth.indices, truth.names) == ((0, 8), ("0000", "0008"))
