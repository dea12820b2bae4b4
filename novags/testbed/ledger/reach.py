"""The reach of code: every definition that may run when some modules are used.

A function or a constant runs where code that runs names it, a method where code that runs names its class, and the top
of a module where that module is imported. So the reached code is found from the sources alone: the names in a
definition, the module's imports under these names, and definitions named as text, "package.module:NAME", as in tables.
The rows of a `Registry` are not followed. An object that comes from elsewhere has a class that somebody
names. Of a row from outside, modules that are not installed are followed like its own.
"""
# tests/end_to_end/ledger/test_what_runs.py watches small stages and finds nothing that runs and is not reached.

import sys
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from novags.testbed.ledger.source import SourceCode, sources
from sensor_model.files.python import ROOT

PACKAGES = ("novags", "simscenes", "sensor_model")
# Modules that return nothing that a result depends on: they tell, show, wait, lock and compare. And the presets of
# cameras: a configuration holds every value of its camera.
OUTSIDE = (
    *(f"novags.{name}" for name in ("cli", "commands", "failure", "interface", "options", "process", "testing")),
    *(f"novags.testbed.{name}" for name in ("console", "flight", "ledger", "loggers", "report", "site", "viewer")),
    "novags.warm",
    "novags.splats.warm",
    "novags.fields.warm",
    "sensor_model.fast.machine_code",
    "sensor_model.files.lock",
    "sensor_model.files.outside",
    "sensor_model.presets",
)  # fmt: skip
INSTALLED = ("site-packages", "dist-packages")  # folders of packages of which a version stands for the content


@dataclass(frozen=True)
class Counted:
    """The counting definitions of a module.

    Attributes:
        definitions: Numbers of the definitions that count.
        imports: Names of the imports that are used.
    """

    definitions: set[int] = field(default_factory=set)
    imports: set[str] = field(default_factory=set)


def reached(roots: Iterable[str]) -> dict[str, Counted]:
    """The counting definitions of each of our modules if all of `roots` are used. A module that is imported alone
    counts nothing.

    Raises:
        ValueError: If there is no such module.
    """
    roots = [*roots]
    walk = _Walk(frozenset((*PACKAGES, *(root.partition(".")[0] for root in roots))))
    for root in roots:
        walk.whole(root)
    walk.finish()
    return {module: counted for module, counted in walk.found.items() if counted.definitions or counted.imports}


@cache
def is_outside(module: str) -> bool:
    """Whether no result depends on a module."""
    return any(module == place or module.startswith(f"{place}.") for place in OUTSIDE)


def path_of(module: str) -> Path:
    """The file of a module that is known to have one."""
    found = _file(module)
    assert found is not None
    return found


def source_of(module: str) -> SourceCode:
    """The analysed file of a module."""
    return _module(module).source


class _Walk:
    """From definition to definition."""

    def __init__(self, ours: frozenset[str]) -> None:
        self.found: dict[str, Counted] = {}
        self._ours = ours  # packages
        self._of_plugins = not ours <= {*PACKAGES}
        self._waiting: list[tuple[str, int]] = []  # definitions to follow
        self._loading: list[str] = []  # modules whose imports are to be followed

    def finish(self) -> None:
        """Follow the names found."""
        while self._waiting or self._loading:
            if self._loading:
                self._load(self._loading.pop())
                continue
            module, number = self._waiting.pop()
            for other, counted in _next(module, number, self._ours).items():
                if self._enters(other):
                    self._add(other, counted.definitions)
                    self.found[other].imports.update(counted.imports)

    def follow(self, module: str, number: int) -> None:
        """The names in a definition."""
        definition = _module(module).source.definitions[number]
        for use in definition.uses:
            self.name(module, *use.split("."))
        for base, name in definition.reaches:
            self.reference(_absolute(base, module), name)

    def _load(self, module: str) -> None:
        """The imports that importing a module causes."""
        self._enters(module.rpartition(".")[0])
        for base, name in _module(module).loads:
            if name == "*":
                self.whole(base)
            elif self._enters(base) and name and _file(f"{base}.{name}") is not None:
                self._enters(f"{base}.{name}")

    def whole(self, module: str) -> None:
        """Everything in a module."""
        if self._enters(module):
            source = _module(module).source
            self._add(module, range(len(source.definitions)))
            for name in source.imports:
                self.name(module, name)

    def reference(self, module: str, name: str, *attributes: str) -> None:
        """The object of `from module import name`, or "module:name", and attributes of that; name "": the module."""
        names = attributes if name in ("", "*") else (name, *attributes)
        if names:
            self.name(module, *names)
        else:
            self.whole(module)

    def name(self, module: str, name: str, *attributes: str) -> None:
        """The object that a name means in a module."""
        if not self._enters(module):
            return
        known = _module(module)
        self._add(module, known.bound.get(name, ()))
        if name in known.source.imports:
            base, inner = known.source.imports[name]
            self.found[module].imports.add(name)
            self.reference(_absolute(base, module), inner, *attributes)
        elif name in known.lazy:
            self.reference(*known.lazy[name], *attributes)
        elif name not in known.bound and _file(f"{module}.{name}") is not None:
            self.reference(f"{module}.{name}", "", *attributes)
        elif name not in known.bound:  # it is made as the program runs
            self.whole(module)

    def _enters(self, module: str) -> bool:
        """Whether a module is one of ours on which results depend; the code that importing it runs is found."""
        if module in self.found:
            return True
        package = module.partition(".")[0]
        if package not in self._ours and not (self._of_plugins and _is_own_work(package)):
            return False
        if is_outside(module) or not _is_known(module):
            return False
        self.found[module] = Counted()
        self._loading.append(module)
        self._add(module, _module(module).runs)
        return True

    def _add(self, module: str, numbers: Iterable[int]) -> None:
        known = self.found[module].definitions
        new = [number for number in numbers if number not in known]
        known.update(new)
        self._waiting += [(module, number) for number in new]


@cache
def _next(module: str, number: int, ours: frozenset[str]) -> dict[str, Counted]:
    """The definitions and imports that one definition names itself, by module, however far the walk has come."""
    walk = _Walk(ours)
    walk.follow(module, number)
    return walk.found


@dataclass(frozen=True)
class _Module:
    """The analysed source of a module, to look up.

    Attributes:
        source: All of it.
        bound: The definitions of each name.
        runs: Definitions that count wherever the module is imported.
        loads: Module and name of the imports that importing it causes.
        lazy: Module and name of objects that are imported when they are used, by their names here.
    """

    source: SourceCode
    bound: dict[str, list[int]]
    runs: list[int]
    loads: list[tuple[str, str]]
    lazy: dict[str, tuple[str, str]]


@cache
def _module(module: str) -> _Module:
    path, bound = path_of(module), dict[str, list[int]]()
    source = sources().of(path.read_bytes())
    for number, definition in enumerate(source.definitions):
        for name in definition.names:
            bound.setdefault(name, []).append(number)
    runs = [number for number, definition in enumerate(source.definitions) if definition.runs]
    stub = path.with_suffix(".pyi")
    lazy = sources().of(stub.read_bytes()).imports if stub.is_file() else {}

    def named(pair: tuple[str, str]) -> tuple[str, str]:
        return _absolute(pair[0], module), pair[1]

    loads = [named(pair) for pair in source.loads]
    return _Module(source, bound, runs, loads, {name: named(pair) for name, pair in lazy.items()})


def _file(module: str) -> Path | None:
    """The file of a module: of ours by its name, of another one by where it is loaded from; None if it has none."""
    if module.partition(".")[0] in PACKAGES and (found := _of_ours(module)):
        return found
    place = getattr(sys.modules.get(module), "__file__", None) or _would_load(module)
    return Path(place) if place and place.endswith(".py") and Path(place).is_file() else None


@cache
def _is_own_work(package: str) -> bool:
    """Whether a package is somebody's own, as a plugin may import it: neither of Python nor installed, so that it may
    change under one version. Nothing is imported.
    """
    if package in sys.stdlib_module_names:
        return False
    with suppress(ImportError, ValueError):
        if (spec := find_spec(package)) is not None:
            places = [*(spec.submodule_search_locations or ()), *([spec.origin] if spec.has_location else [])]
            return bool(places) and not any({*INSTALLED} & {*Path(str(place)).parts} for place in places)
    return False


@cache
def _would_load(module: str) -> str | None:
    """Where a module from outside would be loaded from that is not, as one that is imported when it is needed."""
    if module.partition(".")[0] in PACKAGES:  # to look for it would import the modules above it
        return None
    with suppress(ImportError, ValueError):
        return None if (spec := find_spec(module)) is None else spec.origin
    return None


@cache
def _of_ours(module: str) -> Path | None:
    place = Path(ROOT, *module.split("."))
    return next((path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()), None)


def _is_known(module: str) -> bool:
    """Whether it has a file. One that was loaded without (typed in, or made as the program ran) says nothing of itself.

    Raises:
        ValueError: If there is no such module.
    """
    if _file(module) is not None:
        return True
    if module.partition(".")[0] in PACKAGES and module not in sys.modules:
        raise ValueError(f"there is no module {module} in {', '.join(PACKAGES)}")
    return False


def _absolute(name: str, module: str) -> str:
    """The module that `from name import ...` means in a module."""
    relative = name.lstrip(".")
    if relative == name:
        return name
    package = module if path_of(module).name == "__init__.py" else module.rpartition(".")[0]
    above = package.split(".")[: len(package.split(".")) - (len(name) - len(relative)) + 1]
    return ".".join([*above, relative]) if relative else ".".join(above)
