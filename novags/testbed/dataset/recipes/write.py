"""Samples of recipes on disk: training/RECIPE/SPLIT/CAPTURE/VIEW.npz, and training/RECIPE/index.csv, a row for each.

CAPTURE is the brightest of a group. A folder appears when all samples of its group are in it, and stays as long as the
recipe and the files of the group do.
"""

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.console.csv_text import as_csv
from novags.testbed.console.terminal import Console
from novags.testbed.dataset.publish import INDEX, DatasetEntry
from novags.testbed.dataset.recipes.listed import RECIPES
from novags.testbed.dataset.recipes.recipe import group_key, opened_group
from novags.testbed.ledger.code import code_of
from novags.testbed.ledger.contents import digest, read_json, write_json
from sensor_model.files.atomic import atomic, remove, write_text

FOLDER, MADE = "training", ".made.json"


def write_recipes(names: Sequence[str], entries: Sequence[DatasetEntry], out: Path, console: Console) -> list[str]:
    """Write the samples that are not there yet, and remove samples of an earlier file of this data set.

    Args:
        names: Of recipes.
        entries: Of the data set, linked already.
        out: The data set.
        console: Where progress goes.

    Returns:
        Names of all files, relative to the data set.

    Raises:
        OSError: If the disk is full or may not be written to.
        ValueError: If a recipe refuses a capture; names it.
    """
    sets = {entry.task.key: entry for entry in entries if entry.task.kind == "set"}
    groups = grouped(entry for entry in entries if entry.task.kind == "capture") if names else []
    files = list[str]()
    with console.progress("recipes") as progress:
        for k, name in enumerate(names):
            rows = list[dict[str, Any]]()
            for g, group in enumerate(groups):
                rows += _rows_of(name, group, sets[group[0].task.needs[0]], out)
                progress(k * len(groups) + g + 1, len(names) * len(groups), name)
            write_text(out / FOLDER / name / INDEX, as_csv(rows))
            files += [f"{FOLDER}/{name}/{INDEX}", *(row["file"] for row in rows)]
    _remove_others(files, out)
    return files


def grouped(captures: Iterable[DatasetEntry]) -> list[list[DatasetEntry]]:
    """Captures that differ in their light alone, the darkest first."""
    found: dict[str, list[DatasetEntry]] = {}
    for entry in captures:
        found.setdefault(group_key(entry.task.needs[0], entry.task.config), []).append(entry)
    return [sorted(group, key=lambda entry: float(entry.record["electrons"])) for group in found.values()]


def _rows_of(name: str, group: Sequence[DatasetEntry], lit: DatasetEntry, out: Path) -> list[dict[str, Any]]:
    """The rows of the samples of a group, which are made unless they are there."""
    split, scene = group[0].split, group[0].scene
    place = f"{FOLDER}/{name}/{split}/{group[-1].task.name}"
    key = digest([code_of(RECIPES[name].module).key, *(entry.files for entry in (*group, lit))])
    made = read_json(out / place / MADE) if (out / place / MADE).is_file() else {}
    if made.get("key") != key or not all((out / row["file"]).is_file() for row in made["rows"]):
        opened = opened_group([out / entry.place for entry in group], out / lit.place)
        rows = []
        with atomic(out / place) as temporary:
            temporary.mkdir()
            for sample in RECIPES[name].samples(opened):
                np.savez(temporary / sample.name, **sample.arrays)  # type: ignore[arg-type]  # without dates inside
                rows.append({"split": split, "scene": scene, "file": f"{place}/{sample.name}.npz", **sample.row})
            made = {"key": key, "rows": rows}
            write_json(temporary / MADE, made)
    found: list[dict[str, Any]] = made["rows"]
    return found


def _remove_others(files: Collection[str], out: Path) -> None:
    """Remove the groups and indices of an earlier file of this data set; what somebody put beside them stays."""
    kept = {(out / name).parent for name in files}
    for path in sorted((out / FOLDER).glob(f"*/*/*/{MADE}")):
        if path.parent not in kept:
            remove(path.parent)
            _prune(path.parent.parent)
    for name in RECIPES:
        if f"{FOLDER}/{name}/{INDEX}" not in files and (out / FOLDER / name).is_dir():
            (out / FOLDER / name / INDEX).unlink(missing_ok=True)
            _prune(out / FOLDER / name)
    _prune(out / FOLDER)


def _prune(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
