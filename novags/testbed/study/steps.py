"""The stages that make each kind of entry of a store: where a study calls the test bed."""

from pathlib import Path
from typing import Any

from novags.testbed import stages
from novags.testbed.console import Console
from novags.testbed.folders import capture as captures
from novags.testbed.folders import run as runs
from novags.testbed.metrics import PerceptualDistance
from novags.testbed.stages.render import RECORD as SET
from novags.testbed.study.entry import Step, Steps, Task


def steps(task: Task, folder: Path, source: Path | None, console: Console) -> Steps:
    """What makes an entry.

    Args:
        task: What has to be made.
        folder: Where.
        source: The set that a capture photographs, or the capture of a run.
        console: Where progress goes.
    """
    if task.kind == "set":
        return {"render": Step(lambda: stages.render(folder, task.config, console), SET)}
    assert source is not None
    if task.kind == "capture":
        return {"capture": Step(lambda: stages.capture(source, folder, task.config, console), captures.RECORD)}
    return {
        "reconstruct": Step(lambda: stages.reconstruct(source, folder, task.config, console), runs.RECORD),
        "score": Step(lambda: stages.score(folder, console), runs.METRICS, repeatable=True),
    }


def depends(task: Task) -> dict[str, Any]:
    """What the content depends on that is no part of the key: with LPIPS installed later, scores alone are redone."""
    return {"lpips": PerceptualDistance.missing() is None} if task.kind == "run" else {}


def limit_threads(count: int) -> None:
    """What no variable of the environment limits."""
    import cv2

    cv2.setNumThreads(count)
