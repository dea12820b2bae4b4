"""The code of a result: definitions that its stage and its rows reach, with the data files beside it.

The unit is a definition at the top of a module: a function, a class, a constant (`reach.py` says how they are found).
The rows of a `Registry` are not followed: a result depends on the rows that it uses, not on all that could have been.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

from novags.testbed.ledger.reach import PACKAGES, Counted, is_outside, path_of, reached, source_of
from novags.testbed.ledger.source import hashed, sources
from sensor_model.files.outside import origin_of
from sensor_model.files.python import ROOT


@dataclass(frozen=True)
class Code:
    """The code that makes a result.

    Attributes:
        files: Hash of the counting definitions in every file (of data: of the content), by its path from the root.
        texts: Hash of the whole content of the same files.
        roots: The modules that reach them.
        outside: Version of every package and file from outside among the roots, by its name.
    """

    files: dict[str, str]
    texts: dict[str, str]
    roots: tuple[str, ...] = ()
    outside: dict[str, str] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Hash of all files."""
        return hashed("\n".join(f"{name} {found}" for name, found in sorted(self.files.items())).encode())

    def along_with(self, modules: Iterable[str]) -> "Code":
        """This code, and the definitions that these modules reach."""
        return code_of(*self.roots, *modules)


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
    files, texts = dict[str, str](), dict[str, str]()
    for module, counted in reached(roots).items():
        path = path_of(module)
        name = _name(path, module)
        files[name], texts[name] = _tokens(module, counted), _content(path)
        beside = {_name(other): _content(other) for other in _beside(path)}
        files, texts = files | beside, texts | beside
    sources().remember()
    origins = {origin.name: origin.version for root in roots if (origin := origin_of(root)) is not None}
    for name, version in origins.items():  # the version of a package stands for its compiled code
        files.setdefault(name, version)
        texts.setdefault(name, version)
    return Code(dict(sorted(files.items())), dict(sorted(texts.items())), tuple(sorted(roots)), origins)


def _tokens(module: str, counted: Counted) -> str:
    """Hash of the counting definitions in a module."""
    source = source_of(module)
    definitions = [source.definitions[number].tokens for number in sorted(counted.definitions)]
    imports = [f"{name} {':'.join(source.imports[name])}" for name in sorted(counted.imports)]
    return hashed("\n".join([*definitions, *imports]).encode())


def _name(path: Path, module: str = "") -> str:
    """The path from the root; of a module from outside the same on every machine."""
    if path.is_relative_to(ROOT):
        return path.relative_to(ROOT).as_posix()
    above = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    return "/".join([*above, path.name])


@cache
def version() -> str:
    """Hash of all code that results depend on, from this machine's files."""
    names = (".".join(path.relative_to(ROOT).with_suffix("").parts) for package in PACKAGES
             for path in Path(ROOT, package).rglob("*.py"))  # fmt: skip
    return _code_of(frozenset(name.removesuffix(".__init__") for name in names if not is_outside(name))).key


def modules_of(config: Any) -> set[str]:
    """The modules that define a configuration and the configurations in it."""
    if not is_dataclass(config) or isinstance(config, type):
        return set()
    return {type(config).__module__}.union(*(modules_of(getattr(config, part.name)) for part in fields(config)))


@cache
def _beside(path: Path) -> tuple[Path, ...]:
    """The data in the folder of a file of code."""
    if not path.is_relative_to(ROOT):  # files beside somebody else's file are not ours to judge
        return ()
    others = (file for file in path.parent.iterdir() if file.suffix not in (".py", ".pyi") and file.is_file())
    return tuple(file for file in others if not file.name.startswith("."))


@cache
def _content(path: Path) -> str:
    return hashed(path.read_bytes())
