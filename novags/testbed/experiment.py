"""The main job: render, capture, reconstruct by every method, score, report, in one folder."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from novags.testbed import stages
from novags.testbed.cache import write_json
from novags.testbed.console import Console
from novags.testbed.folders.experiment import EXPERIMENT, REPORT, find_runs
from novags.testbed.folders.run import METRICS, RECORD
from novags.testbed.presets import Preset
from novags.testbed.report.page import write_report
from novags.testbed.stages.score import merge
from sensor_model.files.lock import locked


def run(preset: Preset, out: Path, console: Console, *, command: str | None = None) -> Path:
    """Run what is still missing of the experiment in `out`; returns the path of the report.

    Args:
        preset: What to do.
        out: The experiment folder: set/, capture/, one folder per method or variant, metrics.json, report.html.
        console: Where progress goes.
        command: The command line, for the record.

    Raises:
        ValueError: If an input is wrong or `out` holds other things.
        BlockingIOError: If another process is writing to `out`.
    """
    with locked(out):
        described = [out / name for name in (EXPERIMENT, METRICS, REPORT)]
        stages.render(out / "set", preset.render, console, stale=described)
        stages.capture(out / "set", out / "capture", preset.capture, console, stale=described)
        for name in preset.methods:
            stages.reconstruct(out / "capture", out / name, preset.reconstruct(name), console, stale=described)
        write_json(out / EXPERIMENT, {"command": command, "methods": preset.methods, "preset": asdict(preset)})
        score_all(out, console)
        return write_report(out, console)


def score_all(folder: Path, console: Console) -> dict[str, Any]:
    """Score a run, or every run of an experiment; returns the mean scores by name.

    Raises:
        ValueError: If `folder` is neither, or what its runs refer to is gone.
        BlockingIOError: If another process is writing there.
    """
    with locked(folder, make=False):
        return _score_all(folder, console)


def _score_all(folder: Path, console: Console) -> dict[str, Any]:
    runs = find_runs(folder)
    metrics = {name: stages.score(run.path, console) for name, run in runs.items()}
    if not (folder / RECORD).exists():
        write_json(folder / METRICS, merge(metrics, {name: run.method for name, run in runs.items()}))
    return {name: run["methods"][name]["mean"] for name, run in metrics.items()}
