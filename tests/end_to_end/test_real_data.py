"""The paper's study file on miniatures of its data sets, by the commands: rows, scores and a report."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from tests.miniatures import lit_picture, llnerf, lom, mvtv

PAPER = Path(__file__).resolve().parents[2] / "docs" / "studies" / "paper.toml"
TINY = """[override]
iterations = 4
points = 60
fit.sh_degree = 0
denoiser.warmup_steps = 2
denoiser.network.widths = [4, 4]
denoiser.network.bottleneck = 8
denoiser.network.se_reduction = 2
"""
FEW = 'method = ["i2-nerf-truth", "nova", "gamma-gs", "drago-gs", "nova-16bit"]\n'


@pytest.mark.usefixtures("one_core")
def test_the_protocol_of_the_paper_runs_on_what_is_there_and_scores_against_lit_pictures(
    tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str], quiet: Console
) -> None:
    """Rationale: the file itself, with few steps and the methods that its own rules name. Expectation: every scene with
    lit pictures has scores, that of MVTV none, and LLRS, which is absent, no row."""
    data = tmp_path / "data"
    lom(data / "LOM" / "buu")
    llnerf(data / "LLNeRF")
    mvtv(data)
    text = PAPER.read_text(encoding="utf-8").replace("[override]\n", TINY)
    (tmp_path / "paper.toml").write_text(re.sub(r"^method = \[.*?^\]\n", FEW, text, flags=re.M | re.S), "utf-8")
    out = tmp_path / "out" / "paper"
    words = ("study", str(tmp_path / "paper.toml"), "--data", str(data), "--out", str(out), "--workers", "1")

    assert call(*words, "--dry-run") == 0
    captured = capsys.readouterr()
    assert "7 runs" in captured.out
    assert f"LLRS is not below {data}: no runs of it" in captured.err
    assert not (tmp_path / "out").exists()

    assert call(*words) == 0
    rows = json.loads((out / "results.json").read_text())["rows"]
    lit = [("data:LOM/buu", name) for name in ("i2-nerf-truth", "nova")]
    lit += [("data:LLNeRF/still2", name) for name in ("i2-nerf-truth", "nova")]
    dark = [("data:MVTV/hall", name) for name in ("gamma-gs", "drago-gs", "nova-16bit")]
    assert [((row["scene"], row["method"]), row["state"]) for row in rows] == [(run, "done") for run in lit + dark]
    for row in rows:
        scored = [row.get(f"lit.{score}") is not None for score in ("psnr", "ssim", "tone_aligned_psnr")]
        assert scored == [(row["scene"], row["method"]) in lit] * 3
    capture = open_capture(next((tmp_path / "out" / "store" / "capture").glob("LLNeRF-still2-*")))
    np.testing.assert_array_equal(np.round(255 * capture.source(quiet).lit(8)), lit_picture(8))
    assert capture.cameras.test_indices == [0, 8]

    assert call("report", str(out)) == 0
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "data:LOM/buu" in page
