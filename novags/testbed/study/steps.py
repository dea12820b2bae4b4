"""The stages that make each kind of entry of a store: where a study calls the test bed."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders import capture as captures
from novags.testbed.folders import run as runs
from novags.testbed.folders.set import for_photographs
from novags.testbed.ledger.code import code_of
from novags.testbed.metrics import missing, modules
from novags.testbed.stages.command import run_command
from novags.testbed.stages.configs.command import CommandConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.configs.posing import PosesConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.layouts import RECORD as SET
from novags.testbed.study.entry import Order, StageStep, Steps, Task, ensure
from novags.testbed.study.knobs.measurement import MEASURED, measure


def make(order: Order, console: Console) -> dict[str, Any]:
    """Make sure that an entry is there and complete; called by workers, see `entry.ensure`."""
    limit_threads(order.threads)
    return ensure(order, steps(order.task, order.folder, order.source, console), console, depends(order.task))


def steps(task: Task, folder: Path, source: Path | None, console: Console) -> Steps:
    """The steps that make an entry.

    Args:
        task: The task.
        folder: Where.
        source: The set that a capture photographs, or the capture of a run or a measurement.
        console: Where progress goes.
    """
    if task.kind == "measurement":
        return {"measure": StageStep(lambda: measure(folder, task.config, source, console), MEASURED)}
    config, again, stale = task.config, task.overwrite, [folder.parent / name for name in task.stale]
    if task.kind == "set":
        name = "poses" if isinstance(config, PosesConfig) else "render"
        return {name: StageStep(lambda: make_set(folder, config, console, stale=stale, overwrite=again), SET)}
    assert source is not None
    if isinstance(config, ImportConfig):
        imported = lambda: stages.import_photographs(source, folder, config, console, overwrite=again)  # noqa: E731
        return {"import": StageStep(imported, captures.RECORD)}
    if task.kind == "capture":
        capture = partial(stages.capture, source, folder, config, console, stale=stale, overwrite=again,
                          for_runs=task.for_runs)  # fmt: skip
        return {"capture": StageStep(capture, captures.RECORD)}
    score = StageStep(lambda: stages.score(folder, console), runs.METRICS, repeatable=True)
    if isinstance(config, CommandConfig):
        run = StageStep(lambda: run_command(source, folder, config, console, overwrite=again), runs.RECORD)
        return {"command": run, "score": score}
    run = StageStep(
        partial(stages.reconstruct, source, folder, config, console, stale=stale, overwrite=again), runs.RECORD
    )
    return {"reconstruct": run, "score": score}


def make_set(
    folder: Path, config: RenderConfig | PosesConfig, console: Console, *, stale: Sequence[Path] = (),
    overwrite: bool = False,
) -> None:  # fmt: skip
    """Make a multiview set, rendered or of photographs; arguments and errors as for the two stages."""
    if isinstance(config, PosesConfig):
        stages.poses(folder, config, console, stale=stale, overwrite=overwrite)
    else:
        stages.render(folder, config, console, stale=stale, overwrite=overwrite)


def depends(task: Task) -> dict[str, Any]:
    """Dependencies of the content besides its key: where a score changes, only the scores are made again."""
    if task.kind != "run":
        return {}
    return {
        "unavailable": sorted(missing()),
        "scores": code_of("novags.testbed.stages.scores.scoring", *modules(), *for_photographs()).key,
    }


def limit_threads(count: int) -> None:
    """Threads that no variable of the environment limits."""
    import cv2

    cv2.setNumThreads(count)
