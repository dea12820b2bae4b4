"""A study of measurements: a knob is an axis, each is turned alone, and a repetition is a seed.

[measure]
subject = "render"                 the thing measured: render, sensor, splats, or a method that declares knobs
[override]                         sizes of the work
[grid]                             seed, and of the knobs that are named some of their settings; none named: all of all
[quick.override]  [quick.grid]     what `novags pareto --quick` changes
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from novags.settings import check_seed
from novags.testbed.study.cells.grid import Cell, Study, at, read_study, refuse_unknown
from novags.testbed.study.cells.presets import EXPERIMENTS
from novags.testbed.study.knobs.knob import Setting, Subject
from novags.testbed.study.knobs.measurement import Measurement
from novags.testbed.study.knobs.subjects import sizes_of, subject_of
from sensor_model.files.reading import brief
from sensor_model.files.toml_file import read_toml

TABLES = ("measure", "override", "grid", "quick")


def read_any(path: Path, data: Path | None = None) -> Study:
    """The study of a file, of runs or of measurements; arguments and errors as for `read_study`."""
    table = read_toml(path)
    return measurements_of(path, table) if "measure" in table else read_study(path, data)


def measurements_of(
    path: Path, table: dict[str, Any], *, subject: str | None = None, quick: bool = False,
    seeds: Sequence[int] | None = None,
) -> Study:  # fmt: skip
    """The study of a table.

    Args:
        path: The file.
        table: Its content.
        subject: The subject of a file that names none.
        quick: With the file's tables for that.
        seeds: Instead of the file's.

    Raises:
        ValueError: If a name is unknown or a value is refused; one line that names the file and the place.
    """
    with at(path, ""):
        refuse_unknown(table, TABLES, "table or key")
        for name in (*TABLES, *(f"quick.{part}" for part in ("override", "grid"))):
            if not isinstance(_part(table, name), dict):
                raise ValueError(f"[{name}] must be a table")
        refuse_unknown(_part(table, "measure"), ("subject",), "key")
    fast = table.get("quick", {}) if quick else {}
    with at(path, "[override]"):
        name = _part(table, "measure").get("subject", subject)
        sizes = sizes_of(str(name), {**_part(table, "override"), **fast.get("override", {})})
    of = subject_of(str(name), sizes)
    with at(path, "[grid]"):
        grid = {**_part(table, "grid"), **fast.get("grid", {})}
        wanted = _settings(of, {key: value for key, value in grid.items() if key != "seed"})
        repeated = _seeds(grid.get("seed", 0) if seeds is None else list(seeds))
    cells = [
        Cell({"knob": knob, "setting": setting, "seed": seed}, EXPERIMENTS["demo"],
             Measurement(of.name, sizes, knob, setting, seed))
        for seed in repeated for knob, settings in wanted.items() for setting in settings
    ]  # fmt: skip
    axes = {"knob": tuple(wanted), "setting": tuple(dict.fromkeys(s for each in wanted.values() for s in each)),
            "seed": repeated}  # fmt: skip
    content = {"measure": {"subject": name}, "override": dict(sizes), "grid": grid}
    return Study(path, axes, tuple(cells), 0, content, "measurement")


def _part(table: Mapping[str, Any], name: str) -> Any:
    """A table of a file, or one within it; an empty one where it is missing."""
    found: Any = table
    for word in name.split("."):
        found = found.get(word, {})
    return found


def _settings(of: Subject, given: Mapping[str, Any]) -> dict[str, tuple[Setting, ...]]:
    """The settings of each knob, from the fastest on."""
    declared = {knob.name: knob for knob in of.knobs}
    refuse_unknown(given, tuple(declared), f"knob of {of.name}")
    found: dict[str, tuple[Setting, ...]] = {}
    for name in given or declared:
        knob, chosen = declared[name], _listed(given.get(name, declared[name].settings))
        chosen = [None if value == "none" else value for value in chosen]  # which TOML does not have
        if wrong := [value for value in chosen if value not in knob.settings]:
            raise ValueError(f"{name}: {brief(repr(wrong[0]), 60)} is not among its settings, "
                             f"{', '.join(map(str, knob.settings))}")  # fmt: skip
        found[name] = tuple(setting for setting in knob.settings if setting in chosen)
        replace(knob, settings=found[name])  # refuses settings without the default
    return found


def _seeds(value: Any) -> tuple[int, ...]:
    found = _listed(value)
    for seed in found:
        if type(seed) is not int:
            raise ValueError(f"seed: it must be a whole number, got {brief(repr(seed), 60)}")
        check_seed(seed)
    if not found or len(set(found)) < len(found):
        raise ValueError(f"seed: it must have values, each once, got {brief(repr(value), 100)}")
    return tuple(found)


def _listed(value: Any) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else [value]
