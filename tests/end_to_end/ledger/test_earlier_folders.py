"""Claims about folders that version 0.1.0 made, whose records hold no code: they open, and what cannot go on says so.

`folders_of_0.1.0.zip` was made by the last code before results were keyed by it:

    novags run --scene ball.xml --out all --methods naive --views 3 --width 22 --height 22 --spp 4 --points 60
        --iterations 5
    novags study study.toml --out out/light --workers 1
"""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import open_run
from novags.testbed.viewer.splats import scene_of

MADE = Path(__file__).with_name("folders_of_0.1.0.zip")
SHORT = ("--method", "naive", "--points", "60", "--iterations", "5")


@pytest.fixture
def earlier(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folders, in the working directory."""
    with zipfile.ZipFile(MADE) as archive:
        archive.extractall(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("folder", ["all", "out/light", "all/naive"])
def test_a_report_opens_a_run_and_a_study(earlier: Path, folder: str, call: Callable[..., int]) -> None:
    assert call("report", folder) == 0
    assert (earlier / folder / "report.html").stat().st_size > 10_000


def test_a_run_and_its_capture_can_be_looked_at(earlier: Path) -> None:
    run = open_run(earlier / "all" / "naive")
    capture, lit = run.inputs(Console(quiet=True))
    assert scene_of(run).gaussians.means.shape == (60, 3)
    assert run.rendering("0000").shape == capture.srgb8(0).shape == lit.lit(0).shape == (22, 22, 3)


def test_scores_are_made_again_and_are_what_they_were(
    earlier: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    file = earlier / "all" / "naive" / "metrics.json"
    before = json.loads(file.read_text())["methods"]["naive"]["mean"]
    assert call("score", "all") == 0
    assert "its code is not known" in capsys.readouterr().err
    after = json.loads(file.read_text())["methods"]["naive"]["mean"]
    for kind in ("enhanced", "lit"):
        for name in ("psnr", "aligned_psnr", "ssim"):
            assert after[kind][name] == pytest.approx(before[kind][name], abs=1e-3), (kind, name)


def test_its_capture_can_be_reconstructed_and_its_run_is_not_replaced_unasked(
    earlier: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("reconstruct", "all/capture", *SHORT, "--out", "new") == 0
    assert call("score", "new") == 0
    capsys.readouterr()
    before = (earlier / "all" / "naive" / "run.json").read_bytes()
    assert call("reconstruct", "all/capture", *SHORT, "--out", "all/naive") != 0
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "made by novags 0.1.0, which recorded no code" in line
    assert "add --overwrite" in line
    assert (earlier / "all" / "naive" / "run.json").read_bytes() == before
    assert call("reconstruct", "all/capture", *SHORT, "--out", "all/naive", "--overwrite") == 0


def test_a_study_makes_its_entries_again_and_the_earlier_ones_can_be_pruned(
    earlier: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("study", "study.toml", "--out", "out/light", "--workers", "1") == 0
    capsys.readouterr()
    assert call("store", "prune", "out/store", "out/light") == 0
    assert "removed 3 entries" in capsys.readouterr().out
    assert call("store", "size", "out/store") == 0
    assert "all: 3 entries" in capsys.readouterr().out
    assert call("report", "out/light") == 0
