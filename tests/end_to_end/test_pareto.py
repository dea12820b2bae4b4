"""Curves and budgets by their commands, with real work at the smallest size."""

import json
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from novags.testbed.study.curves.curve import read_curves


def novags(*words: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own: Mitsuba, numba and torch load there."""
    command = [sys.executable, "-m", "novags", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["render", "sensor", "splats", "nova"])
def test_a_subject_is_measured_whole_and_only_once(what: str, tmp_path: Path) -> None:
    words = ("pareto", what, "--quick", "--repeats", "1", "--out", tmp_path / "curves")
    first = novags(*words, cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    points = read_curves(tmp_path / "curves")
    knobs = {point["knob"] for point in points}
    assert all(knob.startswith(f"{what}.") for knob in knobs)
    assert {point["knob"] for point in points if point["default"]} == knobs
    assert {point["knob"] for point in points if point["front"]} == knobs
    assert all(point["cpu_seconds"] > 0 and point["seconds"] > 0 for point in points)
    for name in (f"{what}.svg", f"{what}.md"):
        assert (tmp_path / "curves" / name).stat().st_size > 500
    before = (tmp_path / "curves" / "curves.jsonl").read_text()
    again = novags(*words, cwd=tmp_path)
    assert again.returncode == 0
    made = [path.stat().st_mtime_ns for path in tmp_path.glob(f"store/measurement/{what}-*/measured.json")]
    rows = json.loads((tmp_path / "curves" / what / "results.json").read_text())["rows"]
    assert len({row["folder"] for row in rows}) == len(made)
    assert max(made) < (tmp_path / "curves" / "curves.jsonl").stat().st_mtime_ns
    assert (tmp_path / "curves" / "curves.jsonl").read_text() == before


@pytest.mark.slow
def test_the_tile_of_a_kernel_and_its_reference_change_the_time_and_not_the_picture(tmp_path: Path) -> None:
    """A constant that is changed in some modules only would draw another picture."""
    module = import_module("novags.testbed.study.knobs.splats")  # the package's own name is the subject
    found = {
        (knob, setting): module.measured(knob, setting, 300, 32, 0).error
        for knob, setting in (("tile", 8), ("tile", 16), ("backend", "torch"), ("alpha_min", 1 / 2550))
    }
    assert found["tile", 8] == pytest.approx(found["tile", 16], rel=1e-3)
    assert found["backend", "torch"] == pytest.approx(found["tile", 16], rel=1e-3)
    assert found["alpha_min", 1 / 2550] < 0.7 * found["tile", 16]  # what it leaves out is most of the error


@pytest.mark.slow
def test_an_experiment_with_a_budget_is_chosen_done_and_said(tmp_path: Path) -> None:
    small = ["--scene", "cornell", "--views", "9", "--width", "32", "--height", "32", "--points", "400"]
    words = ("run", *small, "--methods", "nova-fast", "naive", "--budget", "150s", "--out", "out/x")
    done = novags(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    state = json.loads((tmp_path / "out" / "x" / "budget.json").read_text())
    assert "points" not in state["shares"]  # it was given
    assert all(0 < share <= 1 for share in state["shares"].values())
    assert f"budget 150 s: took {state['seconds']:.0f} s, predicted {state['foretold']['seconds']:.0f} s" in done.stdout
    assert (tmp_path / "out" / "x" / "report.html").exists()
    assert done.stderr.index("against the preset") < done.stderr.index("reconstruct")
    again = novags(*words, cwd=tmp_path)
    assert again.returncode == 0
    assert "going on with the earlier choice" in again.stderr


@pytest.mark.slow
def test_a_budget_that_nothing_fits_into_is_one_line_with_one_that_will_do(tmp_path: Path) -> None:
    done = novags("run", "--budget", "3s", "--out", "out/x", cwd=tmp_path)
    assert done.returncode == 2
    last = done.stderr.strip().splitlines()[-1]
    assert re.fullmatch(r"novags: error: a budget of 3 s is too small here; \d+ s will do, or give more time, .*", last)
