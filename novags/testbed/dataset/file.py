"""The file of a data set: a study file without methods, and a table [dataset].

[dataset]
name = "dark-rooms"                its name
licence = "CC-BY-4.0"              of the data, as SPDX spells it
split_by = "scene"                 never lies in two splits: a scene with all its variations, or a "variation"
shard_mb = 256                     WebDataset shards of this size; none if left out
recipes = ["denoiser"]             what networks train on (`recipes.listed`); none if left out
description, version, creators, url, date
[dataset.split]                    train = 0.8, val = 0.1, test = 0.1 if left out; or lists of scenes
"""

import os
import re
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_type_hints

from novags.methods.variant import dotted
from novags.settings import check_seed, converted
from novags.testbed.dataset.noise import with_own_noise
from novags.testbed.dataset.recipes.listed import check_recipes
from novags.testbed.study.cells.axes import OF_RUNS, changes_of, scene_identity, scene_of
from novags.testbed.study.cells.grid import Cell, Study, study_of
from sensor_model.files.door import resolved
from sensor_model.files.reading import brief
from sensor_model.files.toml_file import read_toml
from simscenes.loading.reference import is_scene_file

SPLITS = ("train", "val", "test")
LARGEST_SHARD = 1e6  # MB
SHARES: dict[str, Any] = {"train": 0.8, "val": 0.1, "test": 0.1}
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True, kw_only=True)
class DatasetConfig:
    """The name of a data set and its division.

    Attributes:
        name: Letters, digits and . _ -
        licence: SPDX identifier, or text.
        description: In a sentence or two.
        version: Of the data.
        creators: Names.
        url: Where it will be found.
        date: Of publication, YYYY-MM-DD.
        split_by: The unit that never lies in two splits.
        split: Share of the units, or list of scenes, of each split.
        shard_mb: Size of WebDataset shards, 1e6 bytes; None: no shards.
        recipes: Names of what is made for training, of `recipes.listed`.
        seed: Of the order in which scenes are dealt out to splits.
    """

    name: str
    licence: str
    description: str = ""
    version: str = "1.0.0"
    creators: tuple[str, ...] = ()
    url: str = ""
    date: str = ""
    split_by: Literal["scene", "variation"] = "scene"
    split: dict[str, Any] = field(default_factory=lambda: dict(SHARES))
    shard_mb: float | None = None
    recipes: tuple[str, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise ValueError(f"name must be letters, digits and . _ -, got {brief(repr(self.name), 60)}")
        if not self.licence.strip():
            raise ValueError("licence must be said: CC-BY-4.0, CC0-1.0, ...")
        if self.date and not re.fullmatch(r"\d{4}-\d{2}-\d{2}", self.date):
            raise ValueError(f"date must be YYYY-MM-DD, got {brief(repr(self.date), 60)}")
        if self.shard_mb is not None and not 0 < self.shard_mb <= LARGEST_SHARD:
            raise ValueError(f"shard_mb must be > 0 and at most {LARGEST_SHARD:g}, got {self.shard_mb:g}")
        if len(set(self.recipes)) < len(self.recipes):
            raise ValueError(f"recipes must differ, got {', '.join(self.recipes)}")
        check_seed(self.seed)


def read_dataset(path: Path) -> tuple[Study, DatasetConfig]:
    """Read and check the file of a data set.

    Raises:
        ValueError: If it cannot be read, names methods or photographs, or a value is refused; names the file and the
            key.
    """
    table = read_toml(path)
    about = table.get("dataset")
    try:
        if not isinstance(about, dict):
            raise ValueError('[dataset] is missing: it needs name and licence, such as "CC-BY-4.0"')
        config = _with_named_scenes(_config(about), path)
        for place in ("grid", "override", *(f"rig.{name}" for name in table.get("rig", {}))):
            _refuse_methods(table, place, path.parent)
        if wrong := [name for name in ("variant", "method") if name in table]:
            raise ValueError(f"[{wrong[0]}]: a data set has no methods: remove it")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    study = study_of(path, {key: value for key, value in table.items() if key != "dataset"}, "capture")
    for cell in study.cells:
        if cell.preset.folder or cell.preset.photos or cell.preset.dark:
            raise ValueError(f"{path}: {cell.label}: a data set is of rendered scenes, and this one was photographed: "
                             "leave it out")  # fmt: skip
        if (size := cell.preset.capture.max_size) is not None:
            raise ValueError(f"{path}: {cell.label}: max_size = {size} would make dark pictures smaller than well-"
                             "lit ones: choose width and height instead")  # fmt: skip
    try:
        check_recipes(config.recipes, [cell.preset for cell in study.cells])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    cells = (Cell(c.values, with_own_noise(c.preset, spelled(c.preset.render.scene, path))) for c in study.cells)
    return replace(study, cells=tuple(cells), table=table), config


def spelled(scene: str, file: Path) -> str:
    """The one name of a scene in a data set: its name in the catalogue, or the path from the folder of the file."""
    return os.path.relpath(scene_identity(scene), resolved(file.parent)) if is_scene_file(scene) else scene


def _with_named_scenes(config: DatasetConfig, file: Path) -> DatasetConfig:
    """With the scenes that lists of splits name by their one names."""
    split = dict(config.split)
    for name, listed in config.split.items():
        if isinstance(listed, list):
            try:
                split[name] = [spelled(scene_of(str(scene), file.parent), file) for scene in listed]
            except ValueError as error:
                raise ValueError(f"[dataset.split] {name}: {error}") from error
    return replace(config, split=split)


def _config(about: dict[str, Any]) -> DatasetConfig:
    hints = get_type_hints(DatasetConfig)
    for key in about:
        if key not in hints:
            near = get_close_matches(key, hints, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(hints)}"
            raise ValueError(f"[dataset] has no setting {brief(repr(key), 60)}; {hint}")
    if missing := [key for key in ("name", "licence") if key not in about]:
        raise ValueError(f"[dataset] needs {missing[0]}")
    split = about.get("split", SHARES)
    if not isinstance(split, dict) or not split or any(key not in SPLITS for key in split):
        raise ValueError(f"[dataset.split] must be a table of {', '.join(SPLITS)}")
    values = {key: converted(str(value) if key == "date" else value, hints[key], f"[dataset] {key}")
              for key, value in about.items() if key != "split"}  # fmt: skip
    try:
        return DatasetConfig(**values, split=split)
    except ValueError as error:
        raise ValueError(f"[dataset] {error}") from error


def _refuse_methods(table: dict[str, Any], place: str, folder: Path) -> None:
    """Refuse keys that change no capture."""
    keys: Any = table
    for part in place.split(".", 1):
        keys = keys.get(part, {}) if isinstance(keys, dict) else {}
    for key, value in dotted(keys).items() if isinstance(keys, dict) else ():
        if key in OF_RUNS:
            raise ValueError(f"[{place}] {key}: it belongs to reconstructions, and a data set has none: remove it")
        first = value[0] if isinstance(value, list) and value else value
        try:
            changes = None if isinstance(first, dict | list) or key == "rig" else changes_of(key, first, folder)
        except ValueError:
            continue  # said where the study is read
        if changes is not None and changes.settings:
            raise ValueError(f"[{place}] {key}: it is a setting of methods, and a data set has none: remove it")
