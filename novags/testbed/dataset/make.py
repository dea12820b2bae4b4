"""A finished plan becomes a data set: files, index, shards, metadata, data card; the manifest last.

README.md  manifest.json  croissant.json  index.csv  shards/  training/  SPLIT/set/  SPLIT/capture/
"""

import hashlib
import os
import re
from pathlib import Path
from typing import Any

from novags.testbed.console.provenance import package_version
from novags.testbed.console.terminal import Console
from novags.testbed.dataset.card import card
from novags.testbed.dataset.croissant import croissant
from novags.testbed.dataset.file import SPLITS, DatasetConfig, spelled
from novags.testbed.dataset.publish import INDEX, DatasetEntry, entries_of, link, views_of, write_index
from novags.testbed.dataset.recipes.write import FOLDER as TRAINING
from novags.testbed.dataset.recipes.write import write_recipes
from novags.testbed.dataset.shards import FOLDER, remove_shards, write_shards
from novags.testbed.dataset.splits import splits_of
from novags.testbed.folders.runs import STUDY
from novags.testbed.ledger.contents import write_json
from novags.testbed.study.cells.grid import Study
from novags.testbed.study.plan import StudyPlan
from novags.testbed.study.session import jsonable_table
from sensor_model.files.atomic import remove, write_text
from sensor_model.files.door import opened

MANIFEST, CARD, CROISSANT = "manifest.json", "README.md", "croissant.json"
ENTRY = re.compile(".*-[0-9a-f]{16}")  # the name of a set or a capture, as the store has it


def scenes_of(study: Study) -> list[str]:
    """The scenes of a data set, in the order of the file."""
    return list(dict.fromkeys(spelled(cell.preset.render.scene, study.path) for cell in study.cells))


def splits(study: Study, config: DatasetConfig) -> dict[str, str]:
    """The split of each scene.

    Raises:
        ValueError: If they cannot be divided like that; names the file.
    """
    try:
        return splits_of(scenes_of(study), config)
    except ValueError as error:
        raise ValueError(f"{study.path}: {error}") from error


def publish(plan: StudyPlan, config: DatasetConfig, store: Path, out: Path, console: Console) -> Path:
    """Write the data set; returns its manifest. Existing files are kept.

    Args:
        plan: Of which every entry is complete.
        config: Of the data set.
        store: The store.
        out: Folder of the data set, locked by the caller.
        console: Where progress goes.

    Raises:
        OSError: If the disk is full or may not be written to.
    """
    (out / MANIFEST).unlink(missing_ok=True)  # it says that the data set is complete
    entries = entries_of(plan, store, splits(plan.study, config))
    _remove_others(entries, out)
    with console.progress("publish") as progress:
        for done, entry in enumerate(entries):
            link(entry, store, out)
            progress(done + 1, len(entries), entry.task.name)
    views = list(views_of(entries, out))
    files = _checksums(entries, write_index(views, out), out, console)
    shards: list[str] = []
    if config.shard_mb is None:
        remove_shards(out)
    else:
        sums = {name: facts["sha256"] for name, facts in files.items()}
        shards = write_shards(views, out, config.shard_mb, sums)
        files |= {name: _facts(out / name) for name in shards}
    files |= {name: _facts(out / name) for name in write_recipes(config.recipes, entries, out, console)}
    write_json(out / CROISSANT, croissant(config, list(views[0].row), files, shards))
    manifest = _manifest(config, plan.study, entries, files)
    write_text(out / CARD, card(config, entries, manifest))
    manifest["files"] = files | {name: _facts(out / name) for name in (CROISSANT, CARD)}
    write_json(out / MANIFEST, manifest)
    return out / MANIFEST


def refuse_foreign(out: Path, making: Path) -> None:
    """Refuse a folder that holds files of these names and that no data set was made in.

    Raises:
        ValueError: If it does.
    """
    names = (MANIFEST, CARD, CROISSANT, INDEX, FOLDER, TRAINING, *SPLITS)
    taken = [name for name in names if (out / name).exists()]
    if taken and not (making / STUDY).exists():
        raise ValueError(f"{out} already holds {', '.join(taken)}, and no work of this command is in {making}: choose "
                         "another --out, or add --overwrite")  # fmt: skip


def _remove_others(entries: list[DatasetEntry], out: Path) -> None:
    """Remove sets and captures that an earlier file of this data set had: folders named like entries, nothing else."""
    kept = {entry.place for entry in entries}
    for split in SPLITS:
        for kind in ("set", "capture"):
            for path in sorted((out / split / kind).glob("*")):
                ours = ENTRY.fullmatch(path.name) and path.is_dir()
                if ours and path.relative_to(out).as_posix() not in kept:
                    remove(path)


def _checksums(entries: list[DatasetEntry], rows: list[str], out: Path, console: Console) -> dict[str, dict[str, Any]]:
    """Checksums of the files that hold data: files of the entries, and files of `rows`."""
    places = [place for split in SPLITS for place in sorted(entry.place for entry in entries if entry.split == split)]
    found = [path for place in places for path in sorted((out / place).rglob("*")) if path.is_file()]
    found += [out / name for name in rows]
    result = {}
    with console.progress("checksums") as progress:
        for done, path in enumerate(found):
            result[path.relative_to(out).as_posix()] = _facts(path)
            progress(done + 1, len(found), path.name)
    return result


def _facts(path: Path) -> dict[str, Any]:
    with opened(path) as file:
        found = hashlib.sha256()
        while chunk := file.read(1 << 20):
            found.update(chunk)
    return {"bytes": os.stat(path).st_size, "sha256": found.hexdigest()}


def _manifest(
    config: DatasetConfig, study: Study, entries: list[DatasetEntry], files: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    facts = [entry.facts() for entry in entries]
    captures = [fact for fact in facts if fact["kind"] == "capture"]
    return {
        "name": config.name, "version": config.version, "licence": config.licence, "description": config.description,
        "creators": list(config.creators),
        "software": {name: package_version(name) for name in ("novags", "mitsuba", "numpy")},
        "file": jsonable_table(study), "axes": {name: list(values) for name, values in study.axes.items()},
        "seeds": sorted({fact["seed"] for fact in captures}),
        "render_seeds": sorted({fact["seed"] for fact in facts if fact["kind"] == "set"}),
        "splits": {split: sorted({f["scene"] for f in captures if f["split"] == split}) for split in SPLITS},
        "cost": {
            "seconds": sum(fact["cost"]["seconds"] for fact in facts),
            "peak_bytes": max(fact["cost"]["peak_bytes"] for fact in facts),
            "bytes": sum(fact["bytes"] for fact in files.values()),
        },
        "shards": [name for name in files if name.startswith(f"{FOLDER}/")],
        "entries": facts,
    }  # fmt: skip
