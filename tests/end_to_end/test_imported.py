"""Photographs from the dark, not simulated, through the whole line: which truth there is decides what is scored."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from novags import cli
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.references import enhanced_truth
from novags.testbed.folders.run import open_run
from novags.testbed.folders.set import open_source
from novags.testbed.ledger.code import code_of
from novags.testbed.ledger.made import made_with
from novags.testbed.metrics.images import image_scores
from novags.testbed.report.page import write_report
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.study.cells.presets import EXPERIMENTS, Preset, adapted
from novags.testbed.study.entry import Order
from novags.testbed.study.plan import Planner
from novags.testbed.study.steps import make
from sensor_model import srgb_to_linear
from simscenes import orbit_rig
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import write_cameras

VIEWS, SIDE = 9, 24
NAMES = [f"{i:04d}" for i in range(VIEWS)]


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory, quiet: Console) -> Path:
    """lit/ photographs; ours/ and long/ captures of them; dark/ what a stranger has of ours."""
    folder, rng = tmp_path_factory.mktemp("imported"), np.random.default_rng(3)
    write_cameras(folder / "lit", NAMES, orbit_rig(VIEWS, SIDE, SIDE, 50.0, radius=3.0))
    for name in NAMES:
        coarse = rng.integers(30, 250, (6, 6, 3), dtype=np.uint8)
        write_png(folder / "lit" / "images" / f"{name}.png", cv2.resize(coarse, (SIDE, SIDE)))
    for name, electrons in (("ours", 40.0), ("long", 400.0)):
        stages.capture(folder / "lit", folder / name, CaptureConfig(electrons=electrons), quiet)
    (folder / "dark").mkdir()
    shutil.copy(folder / "lit" / "transforms.json", folder / "dark")
    for part in ("images", "raw"):
        shutil.copytree(folder / "ours" / part, folder / "dark" / part)
    return folder


def reconstructed(capture: Path, out: Path, tiny: Preset, quiet: Console, method: str = "naive") -> dict[str, Any]:
    config = adapted(tiny, points=60, iterations=8).reconstruct(method)
    stages.reconstruct(capture, out, config, quiet)
    return stages.score(out, quiet)


def test_a_stranger_s_pictures_give_the_result_and_the_lit_scores_of_our_own(
    line: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    """Expectation: to the bit, since all that the method and these scores see is the same."""
    config = ImportConfig(lit=line / "lit", sensor="a7s2-iso6400-3chip")
    stages.import_photographs(line / "dark", tmp_path / "cap", config, quiet)
    ours = reconstructed(line / "ours", tmp_path / "a", tiny, quiet, "nova-fast")
    theirs = reconstructed(tmp_path / "cap", tmp_path / "b", tiny, quiet, "nova-fast")
    for kind in ("exr", "denoised", "enhanced", "renders"):
        files = sorted(path.name for path in (tmp_path / "a" / kind).iterdir())
        assert files
        for name in files:
            assert (tmp_path / "a" / kind / name).read_bytes() == (tmp_path / "b" / kind / name).read_bytes(), name
    mine, other = (metrics["methods"]["nova-fast"] for metrics in (ours, theirs))
    assert other["mean"]["lit"] == mine["mean"]["lit"]
    assert other["mean"]["enhanced"] is None
    assert mine["mean"]["enhanced"] is not None
    assert {name: scores["lit"] for name, scores in mine["views"].items()} == {
        name: scores["lit"] for name, scores in other["views"].items()
    }
    assert other["training_2d"] is None
    assert "novags import takes --clean FOLDER" in theirs["unavailable"]["enhanced"]
    assert "lit" not in theirs["unavailable"]
    page = write_report(tmp_path / "b", quiet).read_text(encoding="utf-8")
    assert "Not scored: no noise-free exposure is known of these photographs" in page
    assert "Against the noise-free exposure" not in page
    assert "Against the well-lit photograph" in page
    assert "Nothing was simulated: these are 8-bit and raw photographs." in page


def test_without_any_truth_nothing_is_scored_and_the_report_shows_the_renders(
    line: Path, tiny: Preset, quiet: Console, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    stages.import_photographs(line / "dark", tmp_path / "cap", ImportConfig(), quiet)
    metrics = reconstructed(tmp_path / "cap", tmp_path / "run", tiny, quiet)
    assert metrics["methods"]["naive"]["mean"] == {"enhanced": None, "lit": None}
    assert metrics["methods"]["naive"]["views"] == {"0000": {}, "0008": {}}
    assert {"enhanced", "lit", "geometry"} <= metrics["unavailable"].keys()
    page = write_report(tmp_path / "run", quiet).read_text(encoding="utf-8")
    assert "These photographs have no ground truth, so the renders are not scored" in page
    assert "Nothing is scored, because no truth is known" in page
    assert "<span>error 0</span>" not in page  # the legend of maps that there are not
    assert "PSNR: higher is closer" not in page
    assert (
        page.count("not scored, because no truth is known") == 2 * 4
    )  # strip and grid, with alternative text and title
    assert 'class="scores"' not in page
    assert 'data-key="error-naive"' not in page
    assert 'data-key="render-naive"' in page
    assert " dB" not in page.split("</header>")[0]
    monkeypatch.setattr(sys, "argv", ["novags", "score", str(tmp_path / "run")])
    cli.main()
    assert "naive: not scored: no truth is known" in capsys.readouterr().out


def test_a_long_exposure_lets_the_ceiling_run_and_scores_against_itself(
    line: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    config = ImportConfig(clean=line / "long" / "raw", sensor="a7s2-iso6400-3chip")
    stages.import_photographs(line / "dark", tmp_path / "cap", config, quiet)
    metrics = reconstructed(tmp_path / "cap", tmp_path / "run", tiny, quiet, "oracle")["methods"]["oracle"]
    assert metrics["mean"]["lit"] is None
    run = open_run(tmp_path / "run")
    capture, _ = run.inputs(quiet)
    reference = enhanced_truth(capture, 8, run.enhancement or {})
    assert metrics["views"]["0008"]["enhanced"]["psnr"] == image_scores(run.rendering("0008"), reference)["psnr"]
    ours = reconstructed(line / "ours", tmp_path / "ours", tiny, quiet, "oracle")["methods"]["oracle"]
    # Ten times the light has a tenth of the variance; renders after 8 steps are far worse than what that changes.
    assert metrics["mean"]["enhanced"]["aligned_psnr"] == pytest.approx(ours["mean"]["enhanced"]["aligned_psnr"], abs=1)
    page = write_report(tmp_path / "run", quiet).read_text(encoding="utf-8")
    assert "The reference is the clean long exposure" in page
    assert "Truth: long exposure" in page
    assert "Not scored: nothing shows these views in good light" in page


def test_a_method_that_needs_what_is_missing_says_so_in_one_line_and_others_go_on(
    line: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    (tmp_path / "dark").mkdir()
    shutil.copy(line / "lit" / "transforms.json", tmp_path / "dark")
    shutil.copytree(line / "ours" / "images", tmp_path / "dark" / "images")
    stages.import_photographs(tmp_path / "dark", tmp_path / "cap", ImportConfig(lit=line / "lit"), quiet)
    with pytest.raises(ValueError, match="^oracle learns from noise-free exposures, and of .* takes --clean FOLDER"):
        reconstructed(tmp_path / "cap", tmp_path / "oracle", tiny, quiet, "oracle")
    sixteen = adapted(tiny, pictures="16bit")
    with pytest.raises(ValueError, match="16bit needs the 16-bit linear pictures, and this capture has none: use 8bit"):
        reconstructed(tmp_path / "cap", tmp_path / "16", sixteen, quiet)
    assert reconstructed(tmp_path / "cap", tmp_path / "naive", tiny, quiet)["methods"]["naive"]["mean"]["lit"]


def test_a_plan_counts_the_code_that_the_stages_count(line: Path, quiet: Console, tmp_path: Path) -> None:
    """Rationale: photographs take more code to read than a render; who plans cannot open what is not made yet."""
    planner = Planner(tmp_path, quiet)
    small = adapted(EXPERIMENTS["demo"], points=60, iterations=4, methods=("naive",))
    places = {
        "rendered": adapted(small, n_views=9, width=24, height=24, spp=4),
        "posed": adapted(small, scene=str(line / "lit")),
        "dark": adapted(small, dark=line / "dark"),
    }
    chains = {
        name: [planner.tasks[key] for key in _chain(planner, planner.run(place))] for name, place in places.items()
    }
    assert [task.kind for task in chains["rendered"]] == ["set", "capture", "run"]
    contents = dict[str, str]()
    for chain in chains.values():
        for before, task in zip([None, *chain], chain, strict=False):
            folder, source = task.folder(tmp_path), before.folder(tmp_path) if before else task.source
            contents[task.key] = make(Order(task, folder, source, contents, 1), quiet)["content"]
            assert made_with(folder, f"{task.kind}.json").files == code_of(*task.roots).files
    files = {name: set(code_of(*chain[-1].roots).files) for name, chain in chains.items()}
    assert files["posed"] == files["dark"] > files["rendered"]


def _chain(planner: Planner, key: str) -> list[str]:
    return [*(above for need in planner.tasks[key].needs for above in _chain(planner, need)), key]


def test_photographs_darkened_by_a_few_lines_of_noise_are_imported_by_the_command(
    fox: Path, tiny: Preset, quiet: Console, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """Rationale: no picture here has passed through our camera. Expectation: the lit twin is the photograph, averaged
    in linear light; the dark picture's mean light is what the lines below put in."""
    content = json.loads((fox / "transforms.json").read_text())
    frames = [frame for frame in content["frames"] if (fox / frame["file_path"]).is_file()][:18:2]
    (tmp_path / "dark" / "images").mkdir(parents=True)
    (tmp_path / "dark" / "transforms.json").write_text(json.dumps(content | {"frames": frames}))
    rng = np.random.default_rng(0)
    for frame in frames:
        code = cv2.imread(str(fox / frame["file_path"])) / 255
        light = 0.03 * np.where(code > 0.04045, ((code + 0.055) / 1.055) ** 2.4, code / 12.92)
        noisy = rng.poisson(3000 * light) / 3000
        dark = np.where(noisy > 0.0031308, 1.055 * noisy ** (1 / 2.4) - 0.055, 12.92 * noisy)
        assert cv2.imwrite(str(tmp_path / "dark" / frame["file_path"]), np.round(255 * dark).astype(np.uint8))
    words = ["novags", "import", tmp_path / "dark", "--lit", fox, "--max-size", 40, "--out", tmp_path / "cap"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    cli.main()
    assert capsys.readouterr().out == f"{tmp_path / 'cap'}\n"
    capture, whole = open_capture(tmp_path / "cap"), open_source(fox, quiet, 40)
    assert capture.channels_share == ("demosaicing", "JPEG")
    for i, name in enumerate(capture.names):
        lit = capture.source(quiet).lit(i)
        assert np.abs(lit - whole.lit(whole.views.names.index(name))).max() <= 0.51 / 255
        assert capture.linear(i).mean() == pytest.approx(0.03 * srgb_to_linear(lit).mean(), rel=0.1)
    metrics = reconstructed(tmp_path / "cap", tmp_path / "run", tiny, quiet, "nova-fast")["methods"]["nova-fast"]
    assert metrics["mean"]["lit"]["tone_aligned_psnr"] > 5
