"""Claims about the light slider: what it shows is what the camera of the capture would have taken."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.splats import read_ply, write_ply
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.viewer.light import GREY, ViewerCamera, expose_again
from novags.testbed.viewer.shown import Shown, shown_of
from sensor_model import PRESETS, Exposure, develop, expose, mosaic, photons_for_electrons, srgb_to_linear
from simscenes.sets.pictures.exr import read_exr, write_exr
from simscenes.sets.pictures.png import read_png

QUIET = Console(quiet=True)
Runs = dict[str, Path]


def exposed(shown: Shown, i: int, electrons: float, brighten: bool) -> tuple[np.ndarray, float]:
    return expose_again(
        shown.true_light(i), shown.camera, electrons=electrons, mean_green=shown.true_green(), view=i, brighten=brighten
    )


def test_at_the_light_of_the_capture_the_true_light_gives_the_dark_picture_itself(runs: Runs) -> None:
    (shown,) = shown_of([runs["first"]], QUIET)
    capture = open_capture(runs["capture"])
    for i in (0, 4):
        picture, gain = exposed(shown, i, 50.0, brighten=False)
        assert gain == 1
        assert np.array_equal(picture, np.rint(255 * capture.srgb8(i)))


@pytest.mark.parametrize("electrons", [0.3, 7.0, 3000.0])
def test_at_any_light_it_is_an_exposure_by_the_sensor_model_with_the_seed_of_the_capture(
    runs: Runs, electrons: float
) -> None:
    (shown,) = shown_of([runs["first"]], QUIET)
    light = srgb_to_linear(read_png(runs["capture"].parent / "photos" / "images" / "0002.png"))
    all_green = [srgb_to_linear(read_png(path))[..., 1].mean(dtype=np.float64)
                 for path in sorted((runs["capture"].parent / "photos" / "images").iterdir())]  # fmt: skip
    sensor = PRESETS["a7s2-iso6400-3chip"]
    photons = photons_for_electrons(light, electrons=electrons, mean_green=float(np.mean(all_green)), sensor=sensor)
    frame = expose(photons, sensor, shown.camera.exposure, seed=3, view=2)
    picture, gain = exposed(shown, 2, electrons, brighten=True)
    assert np.array_equal(picture, develop(frame, sensor, digital_gain=gain).srgb8)


def test_brightening_brings_mean_green_to_middle_grey_and_never_darkens(runs: Runs) -> None:
    (shown,) = shown_of([runs["first"]], QUIET)
    flat = np.ones((64, 64, 3), np.float32)
    for electrons in (20.0, 200.0):
        picture, gain = expose_again(flat, shown.camera, electrons=electrons, mean_green=1.0, view=0)
        assert gain > 1
        linear = srgb_to_linear(picture / 255)[..., 1]
        error = 5 * linear.std() / 64 + 0.01  # of clipping at black, too
        assert abs(linear.mean() - GREY) < error
    assert expose_again(flat, shown.camera, electrons=1e6, mean_green=1.0, view=0)[1] == 1


def test_another_camera_can_be_chosen_and_a_wrong_name_is_refused(runs: Runs) -> None:
    (shown,) = shown_of([runs["first"]], QUIET, "imx900-hcg")
    sensor = PRESETS["imx900-hcg"]
    photons = photons_for_electrons(
        shown.true_light(1), electrons=30, mean_green=shown.true_green(), sensor=sensor
    )  # fmt: skip
    frame = expose(mosaic(photons, sensor.cfa), sensor, shown.camera.exposure, seed=3, view=1)
    assert np.array_equal(exposed(shown, 1, 30, brighten=False)[0], develop(frame, sensor).srgb8)
    with pytest.raises(ValueError, match="unknown sensor 'kodak'"):
        shown_of([runs["first"]], QUIET, "kodak")


def test_the_light_of_a_reconstruction_is_its_picture_decoded_and_its_mean_that_of_its_views(runs: Runs) -> None:
    (shown,) = shown_of([runs["second"]], QUIET)
    decoded = []
    for i in range(9):
        channels, _ = read_exr(runs["second"] / "exr" / f"{i:04d}.exr")
        code = np.clip(np.stack([channels[c] for c in "RGB"], -1).astype(np.float64), 0, 1)
        decoded.append(np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4))
    found = shown.linear("naive-l1", shown.runs["naive-l1"].rendering("0003"))
    assert np.allclose(found, decoded[3], atol=1e-6)
    assert shown.run_green("naive-l1") == pytest.approx(np.mean([light[..., 1].mean() for light in decoded]), rel=1e-5)


def test_every_kind_of_picture_is_that_of_its_folder_and_others_are_not_offered(runs: Runs) -> None:
    (shown,) = shown_of([runs["first"], runs["second"]], QUIET)
    assert shown.kinds("naive") == ("dark", "enhanced", "rendered", "true")
    assert shown.kinds("naive-l1") == ("dark", "enhanced", "denoised", "rendered", "true")
    folders = {
        "dark": "../capture/images/0003.png", "enhanced": "enhanced/0003.png", "denoised": "denoised/0003.png",
        "rendered": "renders_train/0003.png", "true": "../photos/images/0003.png",
    }  # fmt: skip
    for kind, path in folders.items():
        found = shown.picture(kind, "naive-l1", 3)
        assert found is not None
        assert np.abs(found - read_png(runs["second"] / path)).max() <= 0.5 / 255 + 1e-6
    assert shown.picture("denoised", "naive-l1", 0) is None  # held out: nothing was denoised


def test_large_pictures_are_exposed_smaller_with_the_light_of_their_pixels_averaged(
    runs: Runs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("novags.testbed.viewer.shown.LONGEST", 4)
    (shown,) = shown_of([runs["first"]], QUIET)
    light = srgb_to_linear(read_png(runs["capture"].parent / "photos" / "images" / "0005.png"))
    expected = light.reshape(3, 16, 4, 16, 3).mean((1, 3))
    assert shown.size == (4, 3)
    assert np.allclose(shown.true_light(5), expected, rtol=1e-5)


def test_a_run_in_linear_light_is_shown_with_its_mean_green_at_middle_grey(runs: Runs, tmp_path: Path) -> None:
    for part in ("photos", "capture", "first"):
        shutil.copytree(runs["capture"].parent / part, tmp_path / part)
    record = json.loads((tmp_path / "first" / "run.json").read_text())
    (tmp_path / "first" / "run.json").write_text(json.dumps({**record, "space": "linear", "enhancement": None}))
    (shown,) = shown_of([tmp_path / "first"], QUIET)
    light = [shown.runs["naive"].rendering(f"{i:04d}") for i in range(9)]
    gain = 0.18 / np.mean([np.maximum(picture[..., 1], 0).mean() for picture in light])
    constant = 0.28209479 * read_ply(tmp_path / "first" / "point_cloud.ply").sh[:, 0].numpy() + 0.5
    drawn = shown.scene("naive")[2].colors  # type: ignore[index]
    for found, expected in ((shown.picture("rendered", "naive", 2), light[2]), (drawn, constant)):
        code = np.clip(gain * expected.astype(np.float64), 0, 1)
        code = np.where(code <= 0.0031308, 12.92 * code, 1.055 * np.maximum(code, 1e-9) ** (1 / 2.4) - 0.055)
        assert np.allclose(found, code, atol=1e-4)
    assert shown.kinds("naive") == ("dark", "rendered", "true")


def test_a_black_run_in_linear_light_is_shown_black(runs: Runs, tmp_path: Path) -> None:
    for part in ("photos", "capture", "first"):
        shutil.copytree(runs["capture"].parent / part, tmp_path / part)
    first = tmp_path / "first"
    record = json.loads((first / "run.json").read_text())
    (first / "run.json").write_text(json.dumps({**record, "space": "linear", "enhancement": None}))
    for file in (first / "exr").iterdir():
        channels, _ = read_exr(file)
        write_exr(file, {name: 0 * plane if name in "RGB" else plane for name, plane in channels.items()})
    gaussians = read_ply(first / "point_cloud.ply")
    black = torch.zeros_like(gaussians.sh)
    black[:, 0] = -0.5 / 0.28209479
    write_ply(first / "point_cloud.ply", replace(gaussians, sh=black))
    (shown,) = shown_of([first], QUIET)
    assert shown.scene("naive")[2].colors.max() < 1e-3  # type: ignore[index]
    assert np.all(shown.picture("rendered", "naive", 2) == 0)


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("config", [None, CaptureConfig(sensor="imx900-hcg", seed=9)])
@pytest.mark.parametrize("known", [True, False])
def test_the_noise_has_the_seed_of_the_capture_whatever_camera_is_chosen(
    seed: int, config: CaptureConfig | None, known: bool
) -> None:
    own = PRESETS["a7s2-iso6400-3chip"] if known else None
    told = SimpleNamespace(noise_seed=seed)
    record = SimpleNamespace(simulated=told, color_matrix=None, demosaic="menon", exposure=Exposure(time=1.0))
    capture: Any = SimpleNamespace(record=record, sensor=own, imported=None)
    source: Any = SimpleNamespace(color_matrix=None, response=None)
    camera = ViewerCamera.of(capture, source, config)
    assert camera.seed == seed
    assert (camera.sensor is own) == (known and config is None)


def test_the_seed_of_the_camera_and_the_view_fix_the_noise_of_an_exposure() -> None:
    light = np.full((24, 32, 3), 0.5)
    camera = ViewerCamera(PRESETS["a7s2-iso6400-3chip"], Exposure(time=1.0), "menon", None, 3)

    def taken(seed: int, view: int) -> bytes:
        picture, _ = expose_again(light, replace(camera, seed=seed), electrons=5.0, mean_green=0.5, view=view)
        return bytes(picture.tobytes())

    assert taken(3, 1) == taken(3, 1)
    assert len({taken(3, 1), taken(4, 1), taken(3, 2)}) == 3


def test_each_run_has_its_own_light_and_its_own_scene() -> None:
    """Both are kept in memory once they are found, the one beside the other."""
    light = {"a": {"0": 0.125, "1": 0.375}, "b": {"0": 0.5, "1": 1.0}}
    runs = {name: SimpleNamespace(space="linear", shows_training_views=True,
                                  rendering=lambda view, name=name: np.full((2, 2, 3), light[name][view]))
            for name in light}  # fmt: skip
    capture: Any = SimpleNamespace(cameras=(0, 1), names=("0", "1"))
    nothing: Any = None
    shown = Shown("t", capture, nothing, runs, nothing, nothing)  # type: ignore[arg-type]
    for _ in range(2):
        assert [shown.run_green(name) for name in "ab"] == [0.25, 0.75]
        scenes = [shown.memo.once(("scene", name), lambda name=name: f"scene of {name}") for name in "ab"]
        assert scenes == [shown.scene(name) for name in "ab"] == ["scene of a", "scene of b"]
