"""Untrusted scene files: the files they may read, the plugins they may run, the work they may cause."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from sensor_model.files.door import admitted, is_given, read_bytes, resolved
from sensor_model.files.reading import brief
from simscenes.loading.checks.complete import check_complete
from simscenes.loading.checks.meshes import check_mesh_file
from simscenes.loading.checks.transforms import check_axis
from simscenes.sets.pictures.whole import whole_content

MAX_TEXT = 64 << 20  # characters of all files together, parameters written out
MAX_INCLUDES = 1000
MAX_INCLUDE_DEPTH = 15  # Mitsuba's own limit on nested files
MAX_DEPTH = 128  # of nested elements; Python's recursion over the loaded scene ends not far beyond
MAX_PARAMETERS = 256
MAX_OBJECTS = 10**7  # with all references written out: Mitsuba visits each, some million a second
PICTURES = (".png", ".jpg", ".jpeg", ".exr")
PATH_TAGS = ("string", "path", "include")  # whose value may be the name of a file
PLUGIN = re.compile("[A-Za-z0-9_]+")
DECLARED = re.compile(rb"""\s*<\?xml[^>]*\sencoding\s*=\s*["']([^"']*)""")


def check_xml(
    path: Path, *, allow_outside: bool = False, parameters: Iterable[tuple[str, str]] = ()
) -> tuple[Path, ...]:
    """Read a scene file as plain XML and refuse it if it reaches for files outside its own folder.

    Mitsuba reads included files and spectra while it parses, so this happens before it sees the file. A name that is
    not found where Mitsuba searches is opened verbatim, from the working directory: that is outside as well.

    Args:
        path: The scene file; a link is replaced by its target, in the target's folder.
        allow_outside: The file is trusted: it may name files and plugins anywhere, in any encoding.
        parameters: Values of its $names, (name, value), instead of its <default>s.

    Returns:
        The scene file, then all files that it and the files it includes name and that exist, links resolved.

    Raises:
        ValueError: If the file is not XML or not UTF-8, declares entities, names a file outside its folder, sets a
            search path, asks for a plugin by a path, comes with plugins, lacks a part that a plugin needs, names a mesh
            or picture file that is cut short, turns about an axis that is not of length 1, or is too large or too deep.
    """
    path = resolved(path)
    given = dict(parameters)
    reader = _SceneReader(path.parent, allow_outside, parameters=dict(given))
    reader.read(path, 0, 0, "")
    if unused := sorted(set(given) - reader.used):
        known = ", ".join(sorted(reader.parameters.keys() - set(unused))) or "none"
        raise ValueError(f"scene file {path} has no parameter {', '.join(unused):.200}; it has {known:.500}")
    reader.check_references()
    for file in reader.files:
        check_mesh_file(file)
        if file.suffix.lower() in PICTURES:
            whole_content(file)
    return tuple(reader.files)


@contextmanager
def searching_only(folder: Path, mi: Any) -> Iterator[None]:
    """Let Mitsuba search this folder and its own data, not the working directory."""
    before, only = mi.file_resolver(), mi.FileResolver()
    only.clear()
    only.append(str(folder))
    only.append(str(mitsuba_folder()))
    mi.set_file_resolver(only)
    try:
        yield
    finally:
        mi.set_file_resolver(before)


@contextmanager
def searching_first(folder: Path, mi: Any) -> Iterator[None]:
    """Let Mitsuba search this folder before its own folders."""
    before = mi.file_resolver()
    more = mi.FileResolver(before)
    more.prepend(str(folder))
    mi.set_file_resolver(more)
    try:
        yield
    finally:
        mi.set_file_resolver(before)


def check_plugin(kind: str) -> None:
    """Refuse a plugin name that is a path, or that would resolve to code in the working directory.

    Raises:
        ValueError: If the name is either.
    """
    if not PLUGIN.fullmatch(kind) or any(Path("plugins").glob(f"{kind}.*")):
        raise ValueError(f"plugin type {kind!r} is not one of Mitsuba's own: names are letters, digits and _, and "
                         "none may lie in a folder 'plugins' beside the scene or in the working directory")  # fmt: skip


def mitsuba_folder() -> Path:
    """Where Mitsuba's own data and plugins are, without importing it."""
    spec = find_spec("mitsuba")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).resolve().parent


@dataclass
class _SceneReader:
    """Reads as Mitsuba does: in document order, the first definition of a parameter wins, also across files."""

    root: Path
    trusted: bool
    files: dict[Path, None] = field(default_factory=dict)  # in order
    parameters: dict[str, str] = field(default_factory=dict)
    holds: dict[str, list[str]] = field(default_factory=dict)  # ids within each id, as definition or as reference
    used: set[str] = field(default_factory=set)  # of the parameters
    text_left: int = MAX_TEXT
    includes_left: int = MAX_INCLUDES

    def __post_init__(self) -> None:
        self.inside = (self.root, mitsuba_folder())
        self.searched = [*self.inside, Path()]
        if not self.trusted and (self.root / "plugins").exists():
            raise ValueError(f"scene folder {self.root} holds a folder 'plugins', whose code Mitsuba would run; rename "
                             "it, or add --allow-outside (allow_outside=True) if you trust the scene")  # fmt: skip

    def read(self, path: Path, includes: int, depth: int, owner: str) -> None:
        """Check one file where it is included: at this depth, in the object with the id `owner`."""
        if includes > MAX_INCLUDE_DEPTH:
            raise ValueError(
                f"scene file {path} includes files more than {MAX_INCLUDE_DEPTH} deep; does one include itself?"
            )
        self.files[resolved(path)] = None
        for tag, attributes, level, within in self._elements(path, depth, owner):
            if "id" in attributes:
                holder = attributes.get("as", "") if tag == "alias" else within
                self.holds.setdefault(holder, []).append(attributes["id"])
            if tag == "rotate":
                check_axis(attributes, path)
            if tag == "default":
                self._define(attributes.get("name", ""), attributes.get("value", ""), path)
            if not self.trusted and "type" in attributes:
                check_plugin(attributes["type"])
            if tag in PATH_TAGS and "value" in attributes:
                self._name(attributes["value"], tag, path)
            if "filename" in attributes:
                found = self._name(attributes["filename"], tag, path)
                if tag == "include":
                    self._count_include(path)
                    self.read(found or path.parent / attributes["filename"], includes + 1, level, within)

    def _parse(self, path: Path) -> ElementTree.Element:
        try:
            self._spend(path.stat().st_size, path)
            text = read_bytes(path, most=MAX_TEXT)
            if not self.trusted:
                _check_encoding(text, path)
            if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
                raise ValueError(f"scene file {path} declares entities, which can grow without bound; write them out")
            return ElementTree.fromstring(text)
        except (OSError, ElementTree.ParseError) as error:
            raise ValueError(f"scene file {path} cannot be read as XML: {brief(error)}") from error

    def _elements(self, path: Path, depth: int, owner: str) -> Iterator[tuple[str, dict[str, str], int, str]]:
        """Tags and attributes in document order, each with its depth and the id of the object around it."""
        waiting = [(self._parse(path), depth + 1, owner)]
        while waiting:
            element, level, within = waiting.pop()
            if level > MAX_DEPTH:
                raise ValueError(
                    f"scene file {path} nests elements more than {MAX_DEPTH} deep; refer to inner ones by id"
                )
            attributes = {name: self._written_out(value, path) for name, value in element.attrib.items()}
            yield element.tag, attributes, level, within
            if "type" in attributes:
                names = [self._written_out(child.get("name", ""), path) for child in element]
                check_complete(attributes["type"], names, [child.tag for child in element], f"scene file {path}")
            inner = attributes.get("id", within)
            waiting.extend((child, level + 1, inner) for child in reversed(element))

    def check_references(self) -> None:
        sizes: dict[str, int] = {}
        try:
            for name in TopologicalSorter(self.holds).static_order():  # inner objects first
                size = 1 + sum(sizes[inner] for inner in self.holds.get(name, ()))
                sizes[name] = min(size, MAX_OBJECTS + 1)  # larger counts may have too many digits
        except CycleError as error:
            raise ValueError(f"scene objects hold each other in a circle: {' in '.join(error.args[1])}") from error
        if sizes.get("", 0) > MAX_OBJECTS:
            raise ValueError(f"scene has more than {MAX_OBJECTS} objects once its references are written out; "
                             "refer less often to objects with references of their own")  # fmt: skip

    def _count_include(self, path: Path) -> None:
        self.includes_left -= 1
        if self.includes_left < 0:
            raise ValueError(f"scene file {path} includes more than {MAX_INCLUDES} files in all; merge some")

    def _spend(self, characters: int, path: Path) -> None:
        self.text_left -= characters
        if self.text_left < 0:
            raise ValueError(f"scene file {path} with its included files, all $parameters written out, is larger than "
                             f"{MAX_TEXT >> 20} MiB; keep meshes in files of their own")  # fmt: skip

    def _define(self, name: str, value: str, path: Path) -> None:
        self.parameters.setdefault(name, value)
        if len(self.parameters) > MAX_PARAMETERS:
            raise ValueError(f"scene file {path} defines more than {MAX_PARAMETERS} parameters; write some out")

    def _written_out(self, value: str, path: Path) -> str:
        if "$" not in value:
            return value
        self._spend(len(self.parameters), path)
        for name in sorted(self.parameters, key=len, reverse=True):  # $ab before $a, as Mitsuba does
            self._spend(value.count(f"${name}") * len(self.parameters[name]), path)  # before it is in memory
            if f"${name}" in value:
                self.used.add(name)
            value = value.replace(f"${name}", self.parameters[name])
        return value

    @staticmethod
    def _refuse_endless(name: str, places: Sequence[Path]) -> None:
        """Mitsuba would open a FIFO or a device of that name, and wait or read for ever."""
        for path in (place / name for place in places if name):
            if path.exists() and not path.is_dir():
                admitted(path)

    def _name(self, name: str, tag: str, path: Path) -> Path | None:
        """Record the file that Mitsuba would open for this word, which may not be a file name at all."""
        if tag == "path":
            self.searched.append(self.root / name)
        places = [path.parent, *self.searched] if tag == "include" else self.searched
        try:
            self._refuse_endless(name, places)
            found = next((place / name for place in places if (place / name).is_file()), None) if name else None
            target = resolved(found or self.root / name)
            is_inside = tag != "path" and any(target.is_relative_to(folder) for folder in self.inside)
            linked = found is not None and tag != "path" and Path(os.path.abspath(found)).is_relative_to(self.root)
            is_inside |= linked and is_given(str(target))  # by a link of the folder to where links may lead
        except OSError:  # too long for a path, but Mitsuba shortens it before it opens
            found, is_inside = None, "/" not in name
        if not self.trusted and not is_inside:
            shown = name if len(name) < 200 else f"{name[:200]}..."
            raise ValueError(f"scene file {path.name} names {shown!r} by <{tag}>, outside its folder {self.root} or a "
                             "further one to search; move the file there, or add --allow-outside (allow_outside=True) "
                             "if you trust the scene")  # fmt: skip
        if found is not None:
            self.files[target] = None
        return found


def _check_encoding(text: bytes, path: Path) -> None:
    """Other encodings may be read differently here and in Mitsuba's parser."""
    declared = DECLARED.match(text.removeprefix(b"\xef\xbb\xbf"))
    try:
        plain = "\0" not in text.decode("utf-8")
    except UnicodeDecodeError:
        plain = False
    if not plain or (declared and declared[1].lower() not in (b"utf-8", b"us-ascii")):
        raise ValueError(
            f"scene file {path} must be UTF-8; convert it, or add --allow-outside (allow_outside=True) if you trust it"
        )
