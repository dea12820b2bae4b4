"""A study file: every combination of its axes, checked whole before anything runs.

preset = "demo"                    source of all other settings
[grid]                             axes, in this order: a value or a list of values each
[override]                         for all runs
[rig.NAME]                         meaning of the value NAME of the axis "rig": views, width, height, ...
[variant.NAME]                     a method with settings of its own
[method.NAME]                      a method that is a program: command, timeout, ...
[[exclude]]                        combinations that are left out: values, or lists of values, of some axes
"""

import itertools
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from novags.methods import with_variants
from novags.methods.variant import Variant, dotted
from novags.testbed.importing.published.named import DataFolder
from novags.testbed.stages.configs.command import read_commands
from novags.testbed.study.cells.axes import Changes, applied, changes_of, check_keys, scene_identity
from novags.testbed.study.cells.presets import EXPERIMENTS, Preset, variants_in
from novags.testbed.study.knobs.measurement import Measurement
from sensor_model.files.door import resolved
from sensor_model.files.reading import brief
from sensor_model.files.toml_file import read_toml

TABLES = ("preset", "grid", "override", "rig", "variant", "method", "exclude")
OWN_AXES = ("method", "seed")  # of every run, so that a rig cannot stand for them
MOST = 100_000  # runs of one study; beyond it the file is taken for a mistake
Value = Any  # text, number or truth, as TOML has them


@dataclass(frozen=True)
class Cell:
    """One run of a study: a value of each axis, and the preset with its one method that they make."""

    values: dict[str, Value]
    preset: Preset
    measured: Measurement | None = None  # the measurement, of a study of measurements

    @property
    def label(self) -> str:
        """The values that tell it from the others."""
        return spelled(self.values)


@dataclass(frozen=True)
class Study:
    """A study file, checked.

    Attributes:
        path: The file.
        axes: The values of each axis, in the order of the file.
        cells: Every combination that is not excluded.
        excluded: How many are.
        table: The content of the file.
        ends: The kind of each combination: a "run", a "capture" of a data set, or a "measurement".
        absent: The published data sets that it names and that are not there.
    """

    path: Path
    axes: dict[str, tuple[Value, ...]]
    cells: tuple[Cell, ...]
    excluded: int
    table: dict[str, Any]
    ends: Literal["run", "capture", "measurement"] = "run"
    absent: tuple[str, ...] = ()


def spelled(values: Mapping[str, Value]) -> str:
    """Values of axes in a few words."""
    return ", ".join(f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
                     for name, value in values.items())  # fmt: skip


def read_study(path: Path, data: Path | None = None) -> Study:
    """Read and check a study file.

    Args:
        path: The file.
        data: Where the published data sets are whose scenes it names.

    Raises:
        ValueError: If the file cannot be read, a name is unknown, a value is refused, values do not go together, or
            nothing is left to run; one line that names the file and the key.
    """
    return study_of(path, read_toml(path), data=DataFolder.of(data))


def study_of(
    path: Path, table: dict[str, Any], ends: Literal["run", "capture"] = "run", data: DataFolder | None = None
) -> Study:
    """The study of a table; arguments as attributes of `Study`, errors as `read_study`."""
    with at(path, ""):
        if "dataset" in table:
            raise ValueError("[dataset]: this is the file of a data set: novags dataset makes it")
        refuse_unknown(table, TABLES, "table or key")
        base = _preset(table.get("preset", "demo"))
        for name in ("grid", "override", "rig", "variant", "method"):
            if not isinstance(table.get(name, {}), dict):
                raise ValueError(f"[{name}] must be a table")
    with at(path, "[variant]"):
        variants = variants_in(path) if table.get("variant") else ()
        with_variants(variants)
    with at(path, ""):
        base = replace(base, commands=read_commands(table.get("method", {}), path.parent))
        if both := {command.name for command in base.commands} & {variant.name for variant in variants}:
            raise ValueError(f"[method.{min(both)}]: a variant is called {min(both)} too: rename one of them")
    data = data or DataFolder()
    reader = _KeyReader(path, base, variants, table.get("override", {}), table.get("rig", {}), ends, data)
    shared = reader.table(reader.override, "[override]")
    with at(path, "[grid] scene"):
        scenes = _listed(table.get("grid", {}).get("scene", []))
        absent = data.absent(scenes)
        there = any(data.matching(scene) for scene in scenes)
    if absent and not there:
        raise ValueError(f"{path}: {data.nothing(absent)}")
    axes = reader.axes(table.get("grid", {}), base, shared)
    combinations = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    kept = _without_excluded(path, table.get("exclude", []), axes, combinations, data)
    cells = tuple(Cell(values, reader.preset(values, shared)) for values in kept)
    return Study(path, axes, cells, len(combinations) - len(cells), table, ends, tuple(absent))


def _preset(name: Any) -> Preset:
    if not isinstance(name, str) or name not in EXPERIMENTS:
        raise ValueError(f"preset: must be one of {', '.join(EXPERIMENTS)}, got {brief(repr(name), 100)}")
    return EXPERIMENTS[name]


@contextmanager
def at(path: Path, place: str) -> Iterator[None]:
    """Name the file and the place in it in errors."""
    try:
        yield
    except ValueError as error:
        where = f"{path}: {place}: " if place else f"{path}: "
        raise ValueError(f"{where}{brief(error)}") from error


def refuse_unknown(table: Mapping[str, Any], known: tuple[str, ...], what: str) -> None:
    """Refuse a key that is not known; the message has one that is spelled alike, if there is one."""
    for key in table:
        if key not in known:
            near = get_close_matches(key, known, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
            raise ValueError(f"unknown {what} {brief(repr(key), 100)}; {hint}")


@dataclass(frozen=True)
class _KeyReader:
    """Keys of a file become changes of its preset."""

    path: Path
    base: Preset
    variants: tuple[Variant, ...]
    override: dict[str, Any]
    rigs: dict[str, Any]
    ends: Literal["run", "capture"]
    data: DataFolder

    @cached_property
    def _folder(self) -> Path:
        """Where relative paths start, whichever folder the file was named from: they are part of keys."""
        return resolved(self.path.parent)

    def table(self, table: Any, place: str) -> Changes:
        """All keys of [override] or [rig.NAME], names and types checked."""
        found = Changes()
        with at(self.path, place):
            if not isinstance(table, dict):
                raise ValueError("it must be a table")
        for key, value in dotted(table).items():
            with at(self.path, f"{place} {key}"):
                if key == "rig" or (key in OWN_AXES and place != "[override]"):
                    raise ValueError(f"it is an axis of its own: list its values as [grid] {key}, and leave "
                                     "combinations out by [[exclude]]")  # fmt: skip
                one, names = self._checked(key, value), found.names()
                if both := one.names().keys() & names.keys():
                    raise ValueError(f"{names[min(both)]} sets the same: remove one of them")
                found = found.and_(one)
        return found

    def axes(self, grid: dict[str, Any], base: Preset, shared: Changes) -> dict[str, tuple[Value, ...]]:
        """The values of every axis; method and seed are always there."""
        found = {}
        _refuse_many(self.path, {key: _listed(listed) for key, listed in dotted(grid).items()})
        for key, listed in dotted(grid).items():
            with at(self.path, f"[grid] {key}"):
                values = _expanded(_listed(listed), self.data)
                if not values:
                    raise ValueError("it has no values: give one, or leave the axis out")
                for value in values:
                    self._axis_value(key, value)
                self._refuse_twice(key, values)
                found[key] = tuple(values)
        _refuse_many(self.path, found)
        self._one_place_each(found, shared)
        if self.ends == "run":
            found.setdefault("method", shared.adapted.get("methods", base.methods))
        found.setdefault("seed", (shared.adapted.get("seed", base.capture.seed),))
        if unused := [name for name in self.rigs if name not in found.get("rig", ())]:
            raise ValueError(f"{self.path}: [rig.{unused[0]}]: no value of [grid] rig names it: use it or remove it")
        return found

    def _axis_value(self, key: str, value: Value) -> None:
        if isinstance(value, list | dict):
            raise ValueError(f"each value must be text, a number, or true or false, got {brief(repr(value), 100)}")
        if key == "rig":
            self._rig(value)
        else:
            self._checked(key, value)

    def _refuse_twice(self, key: str, values: list[Value]) -> None:
        seen: dict[Any, Value] = {}
        for value in values:
            meant = self._meant(key, value)
            if meant in seen:
                also = "" if seen[meant] == value else f", also as {value!r}"
                raise ValueError(f"{seen[meant]!r} is listed twice{also}: leave one out")
            seen[meant] = value

    def _meant(self, key: str, value: Value) -> Any:
        """The common identity of values that mean the same."""
        scene = self._changes(key, value).adapted.get("scene") if key == "scene" else None
        return value if scene is None else scene_identity(scene)

    def _rig(self, name: Value) -> Changes:
        if name not in self.rigs:
            listed = ", ".join(self.rigs) or "none"
            raise ValueError(f"the table [rig.{brief(name, 60)}] is missing; the file has: {listed}")
        return self.table(self.rigs[name], f"[rig.{name}]")

    def _checked(self, key: str, value: Value) -> Changes:
        found = self._changes(key, value)
        check_keys(self.base, found)
        return found

    def _one_place_each(self, axes: Mapping[str, tuple[Value, ...]], shared: Changes) -> None:
        """Refuse a key that two places set: an axis that [override] or a rig overrules would lie about its runs."""
        keys: dict[str, str] = {}
        for place, names in (*self._places(axes), ("[override]", shared.names())):
            for name, key in names.items():
                if name in keys:
                    raise ValueError(f"{self.path}: {place}: {key} is set by {keys[name]} too: remove one of them")
            keys |= dict.fromkeys(names, place)

    def _places(self, axes: Mapping[str, tuple[Value, ...]]) -> Iterator[tuple[str, dict[str, str]]]:
        for key, values in axes.items():
            made = (self._rig(value) if key == "rig" else self._changes(key, value) for value in values)
            yield f"[grid] {key}", dict(item for changes in made for item in changes.names().items())

    def _changes(self, key: str, value: Value) -> Changes:
        return changes_of(key, value, self._folder, self.data.scenes)

    def preset(self, values: Mapping[str, Value], shared: Changes) -> Preset:
        """The preset of one combination."""
        own = Changes()
        for key, value in values.items():
            own = own.and_(self._rig(value) if key == "rig" else self._changes(key, value))
        given = {**shared.adapted, **own.adapted}
        scene = given.get("photos") or given.get("dark") or given.get("scene")
        if scene is not None and (given.keys() & {"photos", "dark"} or os.path.isdir(scene)):
            shared = shared.without_render()  # it is for the scenes that are rendered
            if named := own.of_render():
                raise ValueError(f"{self.path}: [grid]: {', '.join(named)} belong to a render, and {scene} is "
                                 "photographed unchanged: put it into a study of its own")  # fmt: skip
        if "dark" in given:  # the capture's settings in [override] are for the other scenes
            if named := own.of_capture():
                raise ValueError(f"{self.path}: [grid]: {', '.join(named)} belong to a simulated exposure, and {scene} "
                                 "is dark already: put it into a study of its own")  # fmt: skip
        try:
            return applied(self.base, shared.and_(own), self.variants)
        except ValueError as error:
            with at(self.path, self._blamed(values, error)):
                raise

    def _blamed(self, values: Mapping[str, Value], error: ValueError) -> str:
        """The key that is refused by itself too, else the combination: some keys need others."""
        keys = [("[override]", key, value) for key, value in dotted(self.override).items()]
        for axis, value in values.items():
            rig = dotted(self.rigs[value]).items() if axis == "rig" else ()
            keys += [(f"[rig.{value}]", *item) for item in rig] if rig else [("[grid]", axis, value)]
        for place, key, value in keys:
            try:
                applied(self.base, self._changes(key, value), self.variants)
            except ValueError as alone:
                if str(alone) == str(error):
                    return f"{place} {key}"
        return spelled(values)


def _refuse_many(path: Path, axes: Mapping[str, Sequence[Value]]) -> None:
    if (count := math.prod(len(values) for values in axes.values())) > MOST:
        raise ValueError(f"{path}: [grid]: {count} combinations, more than {MOST}: split the study")


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _expanded(values: list[Value], data: DataFolder) -> list[Value]:
    """Values of an axis, with everything that some stand for."""
    return _variations([found for value in values for found in data.matching(value)])


def _variations(values: list[Value]) -> list[Value]:
    """Values of an axis, with "tabletop:0..9" as the ten variations that it stands for.

    Raises:
        ValueError: If the last one comes before the first, or they are too many.
    """
    found: list[Value] = []
    for value in values:
        match = re.fullmatch(r"([a-z_]+:)(\d{1,6})\.\.(\d{1,6})", value) if isinstance(value, str) else None
        first, last = (int(match[2]), int(match[3])) if match else (0, 0)
        if match and not first <= last < first + MOST:
            raise ValueError(f"{value!r} must be NAME:FIRST..LAST with FIRST <= LAST and fewer than {MOST} of them")
        if len(found) > MOST:
            raise ValueError(f"it has more than {MOST} values: split the study")
        found += [f"{match[1]}{number}" for number in range(first, last + 1)] if match else [value]
    return found


def _without_excluded(
    path: Path,
    rules: Any,
    axes: Mapping[str, tuple[Value, ...]],
    combinations: list[dict[str, Value]],
    data: DataFolder,
) -> list[dict[str, Value]]:
    with at(path, "[[exclude]]"):
        if not isinstance(rules, list) or not all(isinstance(rule, dict) and rule for rule in rules):
            raise ValueError("each must be a table [[exclude]] with values of some axes")
    kept = combinations
    for number, rule in enumerate(rules, 1):
        with at(path, f"[[exclude]] {number}"):
            if empty := [key for key, value in dotted(rule).items() if not _listed(value)]:
                raise ValueError(f"{empty[0]} has no values: it would leave nothing out")
            wanted = {key: _expanded(_listed(value), data) for key, value in dotted(rule).items()}
            refuse_unknown(wanted, tuple(axes), "axis")
            for key, listed in wanted.items():
                if missing := [value for value in listed if not _among(value, axes[key])]:
                    known = ", ".join(map(str, axes[key]))
                    raise ValueError(f"{key}: {missing[0]!r} is not among its values in [grid] ({known})")
        kept = [c for c in kept if not all(_among(c[key], values) for key, values in wanted.items())]
    if not kept:
        raise ValueError(f"{path}: [[exclude]]: nothing is left to run")
    return kept


def _among(value: Value, listed: Sequence[Value]) -> bool:
    """Whether a value is one of those listed. Python takes true for 1; in a file they are two things."""
    return any(value == other and isinstance(value, bool) == isinstance(other, bool) for other in listed)
