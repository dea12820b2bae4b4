"""A training that meets a number that is not finite: one line, and nothing that is finished is lost."""

import importlib
import math
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from novags import cli
from novags.splats import NotFinite
from novags.testbed.console.terminal import Console
from novags.testbed.report.page import write_report
from novags.testbed.study.cells.presets import Preset
from novags.testbed.study.place import run

FITTING = importlib.import_module("novags.splats.training.fit")  # the package's `fit` is the function


@pytest.fixture
def planted(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """The photometric loss is NaN from the tenth iteration on; what it returns takes that back."""
    loss = FITTING.default_photometric

    def broken(weight, step, target):
        return loss(weight, step, target) * (math.nan if step.iteration >= 10 else 1)

    monkeypatch.setattr(FITTING, "default_photometric", broken)
    monkeypatch.setattr(FITTING.DirectFit, "takes", lambda *_: False)  # which has no such function to break
    return lambda: monkeypatch.setattr(FITTING, "default_photometric", loss)


def times(folder: Path) -> dict[str, int]:
    return {str(p.relative_to(folder)): p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}


def test_reconstruct_says_it_in_one_line_and_fails_there_again(
    experiment: Path, tmp_path: Path, planted, monkeypatch, capsys
) -> None:
    out = tmp_path / "run"
    command = ["novags", "reconstruct", str(experiment / "capture"), "--out", str(out), "--method", "naive",
               "--points", "300", "--iterations", "30"]  # fmt: skip
    said = []
    for _ in range(2):
        monkeypatch.setattr(sys, "argv", command)
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        assert stopped.value.code not in (0, None)
        said.append(capsys.readouterr().err.splitlines()[-1])
    assert said[0].startswith("novags: error: the loss must be finite, got nan at iteration 10, view ")
    assert said[0].endswith(f"{out}/checkpoint.safetensors leads there again")
    assert said[1] == said[0]


def test_an_experiment_keeps_what_is_finished(
    experiment: Path, tmp_path: Path, tiny: Preset, quiet: Console, planted
) -> None:
    for part in ("set", "capture", "nova-fast", "naive"):
        shutil.copytree(experiment / part, tmp_path / part)
    before = times(tmp_path)
    with pytest.raises(NotFinite, match="at iteration 10, view"):
        run(tiny, tmp_path, quiet, report=write_report)
    now = times(tmp_path)
    assert {name: now.get(name) for name in before} == before
    planted()
    run(tiny, tmp_path, quiet, report=write_report)
    now = times(tmp_path)
    assert {name: now.get(name) for name in before if "metrics" not in name} == {
        name: time for name, time in before.items() if "metrics" not in name
    }
    assert (tmp_path / "oracle" / "run.json").exists()
