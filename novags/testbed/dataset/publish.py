"""Sets and captures of a store as a data set: SPLIT/set/NAME and SPLIT/capture/NAME, and a row for each view.

Files are links to the store's where the disk allows it, and then take no further room; else copies.
"""

import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.testbed.console.csv_text import as_csv
from novags.testbed.dataset.file import SPLITS, spelled
from novags.testbed.folders.capture import RECORD as CAPTURE
from novags.testbed.ledger.contents import not_as_written, read_json
from novags.testbed.ledger.store import Seal, files_of, read_seal
from novags.testbed.stages.layouts import RECORD as SET
from novags.testbed.study.cells.grid import Value
from novags.testbed.study.entry import Task
from novags.testbed.study.plan import StudyPlan
from sensor_model.files.atomic import write_text
from sensor_model.files.door import admitted, check_links
from simscenes.sets.multiview import MultiviewSet, load_set

INDEX, METADATA = "index.csv", "metadata.jsonl"
PICTURES = ("dark", "lit")  # with 8 bits: Pillow, which datasets reads with, takes 8 of 16 and does not say so


@dataclass(frozen=True)
class DatasetEntry:
    """A set or a capture of a data set.

    Attributes:
        task: The task that made it.
        scene: The rendered scene, as `spelled` names it.
        split: Where it lies.
        values: Of the axes, of a capture.
        seal: Its cost.
        files: Checksum of each of its files.
        record: Its set.json or capture.json.
    """

    task: Task
    scene: str
    split: str
    values: dict[str, Value]
    seal: Seal
    files: dict[str, str]
    record: dict[str, Any]

    @property
    def place(self) -> str:
        """Relative to the data set."""
        return f"{self.split}/{self.task.kind}/{self.task.name}"

    def facts(self) -> dict[str, Any]:
        """For the manifest: its kind, its simulated and omitted effects, its cost."""
        kept = {name: self.record.get(name) for name in ("sensor_name", "electrons", "seed", "noise_seed", "spp",
                                                         "n_views", "views", "width", "height")}  # fmt: skip
        kept["views"] = kept["views"] if isinstance(kept["views"], int) else kept["n_views"]
        del kept["n_views"]
        return {
            "place": self.place, "kind": self.task.kind, "split": self.split, "scene": self.scene, "key": self.task.key,
            "values": self.values, **{name: value for name, value in kept.items() if value is not None},
            "simulation": simulated(self.record.get("plan")),
            "cost": {"seconds": sum(self.seal.cost["seconds"].values()), "peak_bytes": self.seal.cost["peak_bytes"],
                     "bytes": self.seal.cost["bytes"]},
        }  # fmt: skip


def simulated(plan: Mapping[str, Any] | None) -> dict[str, Any]:
    """Effects that are in the data, effects that are not, each with its reason, and the bound on the change from
    leaving it out.
    """
    if plan is None:
        return {"on": "all", "off": {}}
    effects = plan["effects"]
    return {
        "on": [effect["name"] for effect in effects if effect["on"]],
        "off": {effect["name"]: effect["reason"] for effect in effects if not effect["on"]},
        "bound": plan["bound"], "unit": plan["unit"],
    }  # fmt: skip


def entries_of(plan: StudyPlan, store: Path, splits: Mapping[str, str]) -> list[DatasetEntry]:
    """Every set and capture of a plan, in its order; all must be complete.

    Args:
        plan: Of a data set.
        store: The store.
        splits: Split of each scene, as `spelled` has it.
    """
    values = {key: cell.values for cell, key in plan.runs}
    found = []
    for task in plan.tasks.values():
        made = plan.tasks[task.needs[0]] if task.needs else task
        folder, seal = task.folder(store), read_seal(task.folder(store))
        assert seal is not None
        record = read_json(folder / (SET if task.kind == "set" else CAPTURE))
        scene = spelled(made.config.scene, plan.study.path)
        found.append(DatasetEntry(task, scene, splits[scene], dict(values.get(task.key, {})), seal,
                           files_of(folder, seal.records), record))  # fmt: skip
    return found


def link(entry: DatasetEntry, store: Path, out: Path) -> None:
    """Put the files of an entry into the data set; files that are there already, and whole, stay.

    Raises:
        OSError: If the disk is full or may not be written to.
    """
    place = out / entry.place
    check_links(place)
    for name in not_as_written(place, entry.files):
        file, source = place / name, admitted(entry.task.folder(store) / name)
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary = file.with_name(f".{file.name}.partial")
        temporary.unlink(missing_ok=True)
        try:
            os.link(source, temporary)
        except OSError:  # another disk, or one without links: a full one shows in the copy
            shutil.copy2(source, temporary)
        temporary.replace(file)
    there = {path.relative_to(place).as_posix() for path in place.rglob("*") if path.is_file()}
    for name in there - entry.files.keys():  # of an interrupted start, or of an earlier file
        (place / name).unlink()


@dataclass(frozen=True)
class DatasetView:
    """One view of a capture: the content of an index row and of a sample of a shard."""

    row: dict[str, Any]
    cameras: MultiviewSet
    i: int


def views_of(entries: list[DatasetEntry], out: Path) -> Iterator[DatasetView]:
    """Every view of every capture, in order."""
    sets = {entry.task.key: entry for entry in entries if entry.task.kind == "set"}
    for entry in entries:
        if entry.task.kind != "capture":
            continue
        lit = sets[entry.task.needs[0]]
        cameras = load_set(out / entry.place)
        for i, name in enumerate(cameras.names):
            place, truth = entry.place, lit.place
            yield DatasetView({
                "split": entry.split, "scene": entry.scene, "sensor": entry.record["sensor_name"],
                "electrons": entry.record["electrons"], "seed": entry.record["seed"],
                "noise_seed": entry.record["noise_seed"], "capture": place, "set": truth,
                "view": name, "held_out": int(i in cameras.test_indices), "dark": f"{place}/images/{name}.png",
                "dark16": f"{place}/images16/{name}.png", "raw": f"{place}/raw/{name}.dng",
                "truth": f"{place}/truth/{name}.exr", "lit": f"{truth}/images/{name}.png",
                "gt": f"{truth}/gt/{name}.exr",
            }, cameras, i)  # fmt: skip


def write_index(views: list[DatasetView], out: Path) -> list[str]:
    """Write the rows of all views, with paths relative to the data set; returns the names of the files.

    index.csv has every view. metadata.jsonl in the folder of a split has the views of the split, as the package
    datasets reads folders of pictures: the paths `dark_file_name` and `lit_file_name` start at that folder.
    """
    write_text(out / INDEX, as_csv([view.row for view in views]))
    names = [INDEX]
    for split in SPLITS:
        file = out / split / METADATA
        if rows := [view.row for view in views if view.row["split"] == split]:
            write_text(file, "".join(f"{json.dumps(_of_hub(row))}\n" for row in rows))
            names.append(f"{split}/{METADATA}")
        else:  # of an earlier file
            file.unlink(missing_ok=True)
    return names


def _of_hub(row: dict[str, Any]) -> dict[str, Any]:
    named = {kind: row[kind].removeprefix(f"{row['split']}/") for kind in PICTURES}
    return {**{key: value for key, value in row.items() if key not in named},
            **{f"{kind}_file_name": name for kind, name in named.items()}}  # fmt: skip
