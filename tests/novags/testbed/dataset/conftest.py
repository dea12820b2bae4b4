"""A finished plan of a data set, whose sets and captures nobody computed: two scenes, three captures of three views."""

import json
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest

ROOT = Path(__file__).resolve().parents[4]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from novags.testbed.console.terminal import Console  # noqa: E402
from novags.testbed.dataset.file import DatasetConfig  # noqa: E402
from novags.testbed.dataset.make import publish  # noqa: E402
from novags.testbed.ledger.contents import checksum  # noqa: E402
from novags.testbed.ledger.store import write_seal  # noqa: E402
from novags.testbed.stages.configs.rendering import RenderConfig  # noqa: E402
from novags.testbed.study.cells.grid import Cell, Study  # noqa: E402
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted  # noqa: E402
from novags.testbed.study.entry import Task  # noqa: E402
from novags.testbed.study.plan import StudyPlan  # noqa: E402
from tests.fuzz.readers.records import make_capture  # noqa: E402

QUIET = Console(quiet=True)
SPLIT = {"train": ["tabletop"], "val": ["cornell"]}
UNUSED = {"forced": False, "contribution": 0.0, "bound": 0.0, "unit": "codes"}  # what a plan has beside
SCENES = ("tabletop:1", "cornell")
CAPTURES = (("tabletop:1", 0), ("tabletop:1", 1), ("cornell", 0))  # scene, seed


@dataclass(frozen=True)
class Finished:
    """A plan, the store that has all of it, and the data set that was made from it."""

    plan: StudyPlan
    store: Path
    out: Path
    config: DatasetConfig


def entry(store: Path, task: Task, made: Path, record: str, changes: dict[str, Any]) -> Task:
    """A folder as an entry of the store, with changes of its record."""
    folder = task.folder(store)
    shutil.copytree(made, folder)
    content = json.loads((folder / record).read_text()) | changes
    (folder / record).write_text(json.dumps(content))
    found = {path.relative_to(folder).as_posix(): path for path in folder.rglob("[!.]*") if path.is_file()}
    content["stage"]["files"] = {name: checksum(path) for name, path in found.items()}
    (folder / record).write_text(json.dumps(content))
    cost = {"seconds": {"work": 1.5, "wait": 0.5}, "peak_bytes": 10, "work": 1.0, "pixels": 1.0, "group": "",
            "threads": 1}  # fmt: skip
    write_seal(folder, task.key, {}, cost, [record])
    return task


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """Tests must not change it."""
    folder = tmp_path_factory.mktemp("dataset")
    make_capture(folder)
    tasks = dict[str, Task]()
    for k, scene in enumerate(SCENES):
        task = Task("set", f"s{k}", f"set-{k:016x}", RenderConfig(scene=scene))
        plan = {"effects": [{"name": name, "on": on, "reason": "dark", **UNUSED} for name, on in
                            (("paths", True), (f"fog {k}", True), ("glass", False), (f"lens {k}", False))],
                "bound": 0.1, "unit": "codes"}  # fmt: skip
        tasks[task.key] = entry(folder / "store", task, folder / "set", "set.json", {"seed": k, "plan": plan})
    cells = []
    for k, (scene, seed) in enumerate(CAPTURES):
        preset = adapted(EXPERIMENTS["demo"], scene=scene, seed=seed)
        task = Task("capture", f"c{k}", f"capture-{k:016x}", preset.capture, needs=(f"s{SCENES.index(scene)}",))
        changes = {"seed": seed, "noise_seed": 70 + k}
        tasks[task.key] = entry(folder / "store", task, folder / "capture", "capture.json", changes)
        cells.append((Cell({"scene": scene, "seed": seed}, preset), task.key))
    axes = {"scene": SCENES, "seed": (0, 1)}
    study = Study(folder / "data.toml", cast(Any, axes), tuple(cell for cell, _ in cells), 0, {}, "capture")
    config = DatasetConfig(name="dark", licence="CC0-1.0", creators=("Jane", "Joe"), split=SPLIT, shard_mb=0.03)
    made = Finished(StudyPlan(study, tasks, tuple(cells)), folder / "store", folder / "data", config)
    made.out.mkdir()
    publish(made.plan, made.config, made.store, made.out, QUIET)
    return made
