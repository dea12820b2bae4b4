"""A tiny study by its command: what it leaves is what the bare stages make, and a start later does nothing twice."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import METRICS
from novags.testbed.study.cells.grid import read_study

STUDY = """
[grid]
scene = "ball.xml"
electrons = [5, 20]
method = "naive"
"""


def modified(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_a_study_makes_what_the_stages_make_and_repeats_or_believes_nothing_wrong(
    tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str], ball_xml: str, smallest: str
) -> None:
    (tmp_path / "study.toml").write_text(STUDY + smallest)
    (tmp_path / "ball.xml").write_text(ball_xml)
    out, store = tmp_path / "out" / "light", tmp_path / "out" / "store"
    words = ("study", str(tmp_path / "study.toml"), "--out", str(out), "--workers", "1")

    assert call(*words, "--dry-run") == 0
    assert "2 runs" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()

    assert call(*words) == 0
    assert "2 runs: 2 done" in capsys.readouterr().out
    rows = json.loads((out / "results.json").read_text())["rows"]
    with (out / "results.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [row["electrons"] for row in rows] == [5, 20]
    assert [float(line["lit.psnr"]) for line in lines] == [row["lit.psnr"] for row in rows]
    assert len(list((store / "set").iterdir())) == 1

    preset = read_study(tmp_path / "study.toml").cells[0].preset
    bare, quiet = tmp_path / "bare", Console(quiet=True)
    stages.render(bare / "set", preset.render, quiet)
    stages.capture(bare / "set", bare / "capture", preset.capture, quiet)
    stages.reconstruct(bare / "capture", bare / "run", preset.reconstruct("naive"), quiet)
    (method,) = stages.score(bare / "run", quiet)["methods"].values()
    assert rows[0]["lit.psnr"] == method["mean"]["lit"]["psnr"]
    run = (out / rows[0]["folder"]).resolve()
    assert (run / "point_cloud.ply").read_bytes() == (bare / "run" / "point_cloud.ply").read_bytes()

    before, true = modified(store), (run / METRICS).read_bytes()
    (run / METRICS).write_bytes(true.replace(b'"psnr": ', b'"psnr": 9'))  # a table of wonders
    assert call(*words) == 0
    assert json.loads((out / "results.json").read_text())["rows"][0]["lit.psnr"] == rows[0]["lit.psnr"]
    changed = [path for path, time in modified(store).items() if time != before[path]]
    assert set(changed) == {run / METRICS, run / f".{METRICS}", run / ".sealed.json"}  # nothing else was done twice
    log = (out / "logs" / f"run-{run.name}.log").read_text()
    assert "metrics.json not as written (checksum)" in log


def test_where_no_cameras_are_found_there_is_a_row_that_says_so_and_the_study_goes_on(
    tmp_path: Path, call: Callable[..., int], ball_xml: str, smallest: str
) -> None:
    """A single grey ball of a few pixels has no features that structure from motion could match."""
    axes = STUDY.replace("[5, 20]", "20").replace(
        '"naive"', '"naive"\ncameras = ["sfm", "known", "sfm:pictures=enhanced"]'
    )
    (tmp_path / "study.toml").write_text(axes + smallest)
    (tmp_path / "ball.xml").write_text(ball_xml)
    assert call("study", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out" / "x"), "--workers", "1") == 1
    rows = json.loads((tmp_path / "out" / "x" / "results.json").read_text())["rows"]
    assert [(row["cameras"], row["state"]) for row in rows] == [
        ("sfm", "failed"), ("known", "done"), ("sfm:pictures=enhanced", "failed"),
    ]  # fmt: skip
    for row, kind, other in ((rows[0], "raw", "enhanced"), (rows[2], "enhanced", "raw")):
        assert row["stage"] == "cameras"  # of which the light charts make a share of 0
        assert f"views of the {kind} pictures, at least 2 are needed: try pictures={other}" in row["reason"]
