"""`novags denoise`: a capture in, single pictures without noise out."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from novags.methods.denoised.config import AdaptConfig, DenoiseConfig
from novags.methods.denoised.denoiser import denoised
from novags.methods.denoised.measured import of_capture
from novags.methods.inputs import LacksInput
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.ledger.contents import read_json
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.denoising import DenoisePicturesConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.reconstructing import raw_pictures
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from sensor_model import to_srgb8

QUIET = Console(quiet=True)
TINY: dict[str, Any] = {"scene": "cornell", "n_views": 3, "width": 32, "height": 32, "spp": 4, "sensor": "a7s2-iso6400"}
CONFIG = DenoisePicturesConfig(denoise=DenoiseConfig(adapt=AdaptConfig(steps=2, batch=1, crop=16), turns=1), seed=3)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("denoise")
    tiny = adapted(EXPERIMENTS["demo"], **TINY)
    stages.render(folder / "set", replace(tiny.render, variant="scalar"), QUIET)
    stages.capture(folder / "set", folder / "capture", tiny.capture, QUIET)
    return folder / "capture"


def test_every_picture_comes_out_linear_and_as_srgb(capture: Path, tmp_path: Path) -> None:
    stages.denoise(capture, tmp_path / "out", CONFIG, QUIET)
    opened = open_capture(capture)
    pictures = of_capture(opened.noise, raw_pictures(opened, [0, 1, 2]), None, ())
    wanted = [view.numpy() for view in denoised(pictures, CONFIG.denoise, seed=3)]
    for i, name in enumerate(opened.names):
        linear = cv2.imread(str(tmp_path / "out" / "linear" / f"{name}.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
        shown = cv2.imread(str(tmp_path / "out" / "srgb" / f"{name}.png"))[..., ::-1]
        assert linear.dtype == np.uint16
        np.testing.assert_allclose(linear / 65535, wanted[i].clip(0, 1), atol=0.5001 / 65535)
        assert np.array_equal(shown, to_srgb8(wanted[i]))
    record = read_json(tmp_path / "out" / "denoise.json")
    assert record["pictures"] == list(opened.names)
    made = (tmp_path / "out" / "linear" / "0000.png").stat().st_mtime_ns
    stages.denoise(capture, tmp_path / "out", CONFIG, QUIET)
    assert (tmp_path / "out" / "linear" / "0000.png").stat().st_mtime_ns == made  # done already
    with pytest.raises(ValueError, match="another request"):
        stages.denoise(capture, tmp_path / "out", replace(CONFIG, seed=4), QUIET)


def test_without_a_known_camera_it_says_so(capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Capture, "noise", None)
    with pytest.raises(LacksInput, match="name its camera"):
        stages.denoise(capture, tmp_path / "out", CONFIG, QUIET)


@pytest.mark.parametrize("distorted", [True, False])
def test_undistorted_pixels_of_three_chips_share_their_noise(distorted: bool, capture: Path, tmp_path: Path) -> None:
    """Rationale: three chips keep the channels apart, and undistortion still mixes neighbours."""
    camera, views = "a7s2-iso6400-3chip", capture.parent / "set"
    stages.capture(views, tmp_path / "chips", CaptureConfig(sensor=camera), QUIET)
    shutil.copytree(tmp_path / "chips" / "images16", tmp_path / "dark" / "images")
    cameras = json.loads((views / "transforms.json").read_text()) | ({"k1": 0.2} if distorted else {})
    for frame in cameras["frames"]:
        frame["file_path"] = f"images/{Path(frame['file_path']).name}"
    (tmp_path / "dark" / "transforms.json").write_text(json.dumps(cameras))
    stages.import_photographs(tmp_path / "dark", tmp_path / "in", ImportConfig(sensor=camera, black=4096), QUIET)
    opened = open_capture(tmp_path / "in")
    assert opened.channels_share == ()
    assert opened.pixels_share == (("resampling",) if distorted else ())
    if distorted:
        with pytest.raises(LacksInput, match="neighbouring pixels' noise is shared through resampling"):
            stages.denoise(tmp_path / "in", tmp_path / "out", CONFIG, QUIET)
    else:
        assert stages.denoise(tmp_path / "in", tmp_path / "out", CONFIG, QUIET)["pictures"] == list(opened.names)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="seed"):
        DenoisePicturesConfig(seed=-1)


def test_another_seed_adapts_to_other_crops(capture: Path, tmp_path: Path) -> None:
    for seed in (3, 4):
        stages.denoise(capture, tmp_path / str(seed), replace(CONFIG, seed=seed), QUIET)
    one, other = (
        cv2.imread(str(tmp_path / str(seed) / "linear" / "0000.png"), cv2.IMREAD_UNCHANGED) for seed in (3, 4)
    )
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("change", [{"sensor": "imx900-hcg"}, {"time": 2.0}, {"black": 9.0}, {"white": 900.0},
                                    {"curve": "srgb"}, {"demosaic": "bilinear"}, {"max_size": 30}])  # fmt: skip
def test_every_setting_of_an_import_is_its_own_part_of_the_request(change: dict[str, Any]) -> None:
    plain = ImportConfig(black=64.0, white=1000.0)
    other = replace(plain, **change)
    before, after = plain.resolved(), other.resolved()
    assert {name: after[name] for name in before if after[name] != before[name]}.items() >= change.items()
    assert (other.codes.black, other.codes.white, other.codes.curve) == (other.black, other.white, other.curve)
