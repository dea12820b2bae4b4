"""The code of a result: every module that its stage and its rows reach, with the data files beside them.

What a module reaches is read from its source: what it imports, anywhere in it, and what it names as text,
"package.module:NAME", as rows of tables do. The rows of a `Registry` are not followed: a result depends on the rows
that it uses, not on all that could have been used.
"""

import sys
from collections.abc import Iterable
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

from novags.testbed.ledger.source import hashed, sources
from sensor_model.files.python import ROOT

PACKAGES = ("novags", "simscenes", "sensor_model")
# What returns nothing that a result depends on: it tells, shows, waits, locks and compares.
OUTSIDE = tuple(
    f"novags.{name}"
    for name in ("cli", "commands", "failure", "options", "process", "testing",
                 *(f"testbed.{part}" for part in ("console", "csv_text", "flight", "help", "ledger", "machine",
                                                  "report", "results", "time_left", "viewer")))
)  # fmt: skip


@dataclass(frozen=True)
class Code:
    """What makes a result.

    Attributes:
        files: Hash of the tokens (of data: of the content) of every file, by its path from the root.
        texts: Hash of the whole content of the same files.
        roots: The modules that reach them.
    """

    files: dict[str, str]
    texts: dict[str, str]
    roots: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Hash of all files."""
        return hashed("\n".join(f"{name} {found}" for name, found in sorted(self.files.items())).encode())


def code_of(*roots: str | None) -> Code:
    """The code that some modules reach.

    Args:
        roots: Names of modules: of a stage, and of the rows that it uses; None: of a row that was made as the program
            ran, whose source is not known.

    Raises:
        ValueError: If there is no such module.
    """
    return _code_of(frozenset(root for root in roots if root))


@cache
def _code_of(roots: frozenset[str]) -> Code:
    files = {path for module in reached(roots) for path in _beside(_path(module))}
    found = {_name(path): _hashes(path) for path in sorted(files)}
    sources().remember()
    tokens = {name: kept for name, (kept, _) in found.items()}
    return Code(tokens, {name: whole for name, (_, whole) in found.items()}, tuple(sorted(roots)))


def reached(roots: Iterable[str]) -> frozenset[str]:
    """The modules of ours that these reach, themselves included.

    Raises:
        ValueError: If there is no such module.
    """
    found, waiting = set[str](), list(roots)
    while waiting:
        module = waiting.pop()
        if module not in found and not _outside(module) and _known(module):
            found.add(module)
            waiting += _edges(module)
    return frozenset(found)


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name


@cache
def version() -> str:
    """Hash of all code that results depend on, as it is on this machine."""
    names = (".".join(path.relative_to(ROOT).with_suffix("").parts) for package in PACKAGES
             for path in Path(ROOT, package).rglob("*.py"))  # fmt: skip
    return _code_of(frozenset(name.removesuffix(".__init__") for name in names if not _outside(name))).key


def modules_of(config: Any) -> set[str]:
    """The modules that define a configuration and the configurations in it."""
    if not is_dataclass(config) or isinstance(config, type):
        return set()
    return {type(config).__module__}.union(*(modules_of(getattr(config, part.name)) for part in fields(config)))


def _outside(module: str) -> bool:
    return any(module == place or module.startswith(f"{place}.") for place in OUTSIDE)


def _file(module: str) -> Path | None:
    """The file of a module: of ours by its name, of another one by where it was loaded from; None if it has none."""
    place = Path(ROOT, *module.split("."))
    if module.partition(".")[0] in PACKAGES:
        if found := next((path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()), None):
            return found
    loaded = getattr(sys.modules.get(module), "__file__", None)
    return Path(loaded) if loaded and loaded.endswith(".py") and Path(loaded).is_file() else None


def _known(module: str) -> bool:
    """Whether it has a file. One that was loaded without (typed in, or made as the program ran) says nothing of itself.

    Raises:
        ValueError: If there is no such module.
    """
    if _file(module) is not None:
        return True
    if module.partition(".")[0] in PACKAGES and module not in sys.modules:
        raise ValueError(f"{module} is no module of {', '.join(PACKAGES)}")
    return False


def _path(module: str) -> Path:
    found = _file(module)
    assert found is not None  # it is known
    return found


@cache
def _beside(path: Path) -> tuple[Path, ...]:
    """A file of code and the data in its folder."""
    if not path.is_relative_to(ROOT):  # what lies beside a file of somebody else is not ours to judge
        return (path,)
    others = (file for file in path.parent.iterdir() if file.suffix not in (".py", ".pyi") and file.is_file())
    return (path, *(file for file in others if not file.name.startswith(".")))


@cache
def _hashes(path: Path) -> tuple[str, str]:
    """Of what counts in a file, and of all of it."""
    content = path.read_bytes()
    text = hashed(content)
    return (sources().of(content).tokens if path.suffix == ".py" else text), text


@cache
def _edges(module: str) -> frozenset[str]:
    """What a module imports or names, of ours."""
    path = _path(module)
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    source, found = sources().of(path.read_bytes()), set[str]()
    ours = {*PACKAGES, module.partition(".")[0]}
    for name, names in source.imports:
        if (base := _absolute(name, package)).partition(".")[0] in ours:
            found |= {_defining(base, each) for each in names} if names else {base}
    found |= {text.partition(":")[0] for text in source.texts if text.partition(".")[0] in ours}
    return frozenset(found - {module})


def _absolute(name: str, package: str) -> str:
    """The module that `from name import ...` means in a package."""
    relative = name.lstrip(".")
    if relative == name:
        return name
    above = package.split(".")[: len(package.split(".")) - (len(name) - len(relative)) + 1]
    return ".".join([*above, relative]) if relative else ".".join(above)


@cache
def _defining(module: str, name: str) -> str:
    """The module that is reached by `from module import name`."""
    if _file(inner := f"{module}.{name}") is not None:
        return inner
    stub = Path(ROOT, *module.split("."), "__init__.pyi")  # of a package whose names are imported when they are used
    if not stub.is_file():
        return module
    imports = sources().of(stub.read_bytes()).imports
    return next((_absolute(base, module) for base, names in imports if name in names), module)
