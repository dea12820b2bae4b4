"""Rows of tables from outside: of installed packages, by their entry points, and of files that `--plugin` names.

An entry point in the group "novags.methods" names a row as our own table does: `mine = "my_package:METHOD"`. A file
says `PLUGIN = {"novags.methods": {"mine": METHOD}}`. A row that cannot be used is named once, and nothing else fails.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import sys
import warnings
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module, metadata, util
from pathlib import Path
from types import ModuleType
from typing import Any

from sensor_model.files.atomic import atomic
from sensor_model.files.door import read_bytes
from sensor_model.files.own import cache_folder, own_folder
from sensor_model.files.reading import brief

GROUPS = tuple(f"novags.{table}" for table in ("methods", "enhancers", "cameras", "scenes", "metrics", "effects"))
VARIABLE = "NOVAGS_PLUGINS"  # tells a worker the files of its parent by content, and which packages must be there
LARGEST = 90_000  # bytes of all files, packed: Linux takes variables of 128 KiB
OWN_MODULES = "; modules of yours must be installed, or in a folder on PYTHONPATH that is not the working directory"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,99}")  # of a row: it is part of names of folders


class BrokenRow(KeyError, ValueError):
    """A row from outside that cannot be used; the message says whose it is, and why."""

    def __str__(self) -> str:
        return str(self.args[0])


@dataclass(frozen=True)
class Origin:
    """Where a row comes from.

    Attributes:
        name: Of the package, or of the file.
        version: Of the package; of a file, the beginning of the hash of its content.
    """

    name: str
    version: str

    def __str__(self) -> str:
        return f"{self.name} {self.version}"


@dataclass(frozen=True)
class Outside:
    """A row from outside, by its reference: "module:NAME", or the object itself in a module."""

    origin: Origin
    module: str
    name: str
    value: Any = None  # of a file, which is loaded already

    def load(self, kind: type | None) -> Any:
        """The row.

        Raises:
            BrokenRow: If it cannot be imported, or is something else than a `kind`.
        """
        try:
            row = self.value
            if row is None:
                row = import_module(self.module)
                for part in self.name.split("."):
                    row = getattr(row, part)
        except Exception as error:  # a stranger's module may raise anything
            why = f"{type(error).__name__}: {brief(error, 200)}"
            raise BrokenRow(f"{self.module}:{self.name} of {self.origin} cannot be used ({why})") from error
        if kind is not None and not isinstance(row, kind):
            raise BrokenRow(f"{self.module}:{self.name} of {self.origin} must be of class "
                            f"{kind.__name__}, got class {type(row).__name__}")  # fmt: skip
        return row


_files: dict[str, tuple[Path, bytes, Any]] = {}  # by the name of its module: the file, its content and its PLUGIN


def rows(group: str) -> dict[str, Outside]:
    """The rows of a group by name: of packages in the order of their names, then of files."""
    found = dict(_installed().get(group, {}))
    for module, (path, content, plugin) in _files.items():
        for name, row in plugin.get(group, {}).items():
            found[name] = Outside(_of_file(path, content), module, name, row)
    return found


@cache
def _installed() -> dict[str, dict[str, Outside]]:
    """The rows of installed packages by group and name. Nothing of theirs is imported."""
    found = dict[str, dict[str, Outside]]()
    every = metadata.entry_points()
    points = sorted((group, point.name, point.dist.name, point.dist.version, point.value)
                    for group in GROUPS for point in every.select(group=group) if point.dist)  # fmt: skip
    for group, name, package, version, value in points:
        module, _, attribute = value.partition(":")
        origin = Origin(package, version)
        if NAME.fullmatch(name) is None:
            once(f"{origin} names a row {name!r:.80} in {group}: a name has letters, digits and . _ + - alone")
        elif name in (known := found.setdefault(group, {})):
            once(f"{origin} names a row {name!r} in {group}, and {known[name].origin} has one of that name: it is kept")
        else:
            known[name] = Outside(origin, module, attribute)
    return found


def origin_of(module: str) -> Origin | None:
    """Where a module comes from that has rows; None of a module of ours, or without."""
    if module in _files:
        return _of_file(*_files[module][:2])
    top, found = module.partition(".")[0], [row for group in _installed().values() for row in group.values()]
    return next((row.origin for row in found if row.module.partition(".")[0] == top), None)


def add_file(path: Path) -> None:
    """Run a file, and take its rows.

    Raises:
        ValueError: If it cannot be read or run, it has no PLUGIN, or that is not rows by group and name.
    """
    _load(path, read_bytes(path))


def files() -> list[Path]:
    """The files that were added."""
    return [path for path, _, _ in _files.values()]


def _load(path: Path, content: bytes) -> None:
    module = f"novags_plugin_{re.sub('[^A-Za-z0-9_]', '_', path.stem)}"
    if module in _files:
        if _files[module][1] == content:
            return
        raise ValueError(f"the plugins {_files[module][0]} and {path} need names that differ")
    loaded = ModuleType(module)
    loaded.__file__ = str(path.absolute())
    sys.modules[module] = loaded  # dataclasses and pickle look for it there
    try:
        exec(compile(content, loaded.__file__, "exec"), vars(loaded))  # the code read is the code run
        plugin = _checked(vars(loaded).get("PLUGIN"))
    except Exception as error:
        del sys.modules[module]
        said = brief(error, 200) if isinstance(error, ValueError) else f"{type(error).__name__}: {brief(error, 200)}"
        said += OWN_MODULES * isinstance(error, ModuleNotFoundError)
        raise ValueError(f"the plugin {path} cannot be used: {said}") from error
    _files[module] = (path, content, plugin)


def _checked(plugin: Any) -> dict[str, dict[str, Any]]:
    wanted = 'it must say PLUGIN = {"novags.methods": {"my-name": METHOD}}'
    if not isinstance(plugin, Mapping) or not all(isinstance(rows, Mapping) for rows in plugin.values()):
        raise ValueError(f"{wanted}, and has no such table")
    if unknown := [group for group in plugin if group not in GROUPS]:
        raise ValueError(f"PLUGIN has a group {unknown[0]!r:.80}; there are {', '.join(GROUPS)}")
    if wrong := [name for rows in plugin.values() for name in rows if NAME.fullmatch(str(name)) is None]:
        raise ValueError(f"PLUGIN names a row {wrong[0]!r:.80}: a name has letters, digits and . _ + - alone")
    return {group: dict(rows) for group, rows in plugin.items()}


def _of_file(path: Path, content: bytes) -> Origin:
    return Origin(path.name, hashlib.blake2b(content, digest_size=4).hexdigest())


def environment(modules: Iterable[str] = ()) -> dict[str, str]:
    """Entries for a worker's environment: the files by content, and the packages of these modules by theirs.

    Raises:
        ValueError: If the files are too large for it.
    """
    tops = {module.partition(".")[0] for module in modules if origin_of(module) and module not in _files}
    packages = {top: [str(origin_of(top)), _content_of(top)] for top in sorted(tops)}
    files = {path.name: base64.b64encode(zlib.compress(content)).decode() for path, content, _ in _files.values()}
    if not files and not packages:
        return {}
    text = json.dumps({"files": files, "packages": packages})
    if len(text) > LARGEST:
        raise ValueError(f"the plugins {', '.join(files)} have {len(text)} bytes packed, and workers take {LARGEST}: "
                         "install them as a package, with entry points")  # fmt: skip
    return {VARIABLE: text}


def arrive() -> str | None:
    """Load in a worker the plugins that its environment names; returns why that cannot be done, None if all is
    right.
    """
    given = json.loads(os.environ.get(VARIABLE, "{}"))
    for top, (origin, content) in given.get("packages", {}).items():
        here = origin_of(top)
        if here is None:
            return f"{os.uname().nodename} lacks the package {origin}, whose rows are used: install it there"
        if str(here) != origin or _content_of(top) != content:
            differs = f"has {here}" if str(here) != origin else "has it with another content"
            return f"{os.uname().nodename} {differs}, and the rows that are used are of {origin}: install the same"
    for name, packed in given.get("files", {}).items():
        content = zlib.decompress(base64.b64decode(packed))
        folder = own_folder(own_folder(cache_folder("plugins")) / hashlib.blake2b(content, digest_size=16).hexdigest())
        if not (path := folder / name).exists():
            with atomic(path) as temporary:
                temporary.write_bytes(content)
        _load(path, content)
    return None


def _content_of(top: str) -> str:
    """Hash of the code of an installed package."""
    spec = util.find_spec(top)
    places = [Path(place) for place in (spec.submodule_search_locations or ())] if spec else []
    files = [path for place in places for path in sorted(place.rglob("*.py"))]
    if spec and not places and spec.origin:
        files = [Path(spec.origin)]
    found = hashlib.blake2b(digest_size=16)
    for path in files:
        found.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()


@cache
def once(text: str) -> None:
    """Warn, once in a process."""
    warnings.warn(text, stacklevel=3)
