"""Captures by the stages of the test bed, in a store: made once, whichever process needs them first."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from novags.testbed.console.cores import cores_here
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.study.cells.axes import OF_RUNS, Changes, applied, changes_of
from novags.testbed.study.cells.presets import EXPERIMENTS
from novags.testbed.study.entry import Order, Task, ensure
from novags.testbed.study.plan import Planner
from novags.testbed.study.steps import depends, steps
from novags.testing.known import DarkCapture
from sensor_model.files.lock import locked

SMALL: dict[str, Any] = {"views": 9, "width": 48, "height": 48, "spp": 32}
QUIET = Console(quiet=True)


def make_capture(store: Path, scene: str | None, electrons: float, settings: Mapping[str, Any]) -> DarkCapture:
    """The capture, from the store if it is there.

    Args:
        store: Folder of the store.
        scene: Of the catalogue, a Mitsuba file, or a folder of posed photographs, relative to the working folder; None:
            cornell, or the folder that `photos` of the settings names.
        electrons: Mean signal of green, e- per pixel and exposure.
        settings: Keys of a study file that belong to sets and captures.

    Raises:
        ValueError: If there is no such scene or setting, or a value is refused.
    """
    if scene is None and "photos" not in settings:
        scene = "cornell"
    keys = {**({} if scene is None else {"scene": scene}), "electrons": electrons, **settings}
    if not ("photos" in settings or (scene is not None and Path(scene).is_dir())):
        keys = {**SMALL, **keys}
    changes = Changes()
    for key, value in keys.items():
        if key in OF_RUNS:
            raise ValueError(f"dark_capture: {key} belongs to a reconstruction, not to a capture: leave it out")
        try:
            found = changes_of(key, value, Path.cwd())
        except ValueError as error:
            raise ValueError(f"dark_capture: {key}: {error}") from error
        if found.settings:
            raise ValueError(f"dark_capture: {key} is a setting of methods, not of a capture: leave it out")
        if twice := changes.adapted.keys() & found.adapted.keys():
            raise ValueError(f"dark_capture: {key} sets {', '.join(sorted(twice))}, which is given too: leave one out")
        changes = changes.and_(found)
    planner = Planner(store, QUIET)
    key = planner.capture(applied(EXPERIMENTS["demo"], changes))
    content: dict[str, str] = {}
    for task in planner.tasks.values():
        content[task.key] = _made(task, store, planner, content)
    return _opened(planner.tasks[key].folder(store), content[key])


def _made(task: Task, store: Path, planner: Planner, content: Mapping[str, str]) -> str:
    """The content of an entry, made if it is not there; another process at work on it is waited for."""
    folder = task.folder(store)
    source = planner.tasks[task.needs[0]].folder(store) if task.needs else task.source
    order = Order(task, folder, source, {need: content[need] for need in task.needs}, cores_here())
    with locked(folder, wait=QUIET.note):
        made: str = ensure(order, steps(task, folder, source, QUIET), QUIET, depends(task))["content"]
    return made


@cache
def _opened(folder: Path, content: str) -> DarkCapture:
    """One object for one content: files that tests have read from it are not read again."""
    capture: Capture = open_capture(folder)
    return DarkCapture.of(capture, capture.source(QUIET))
