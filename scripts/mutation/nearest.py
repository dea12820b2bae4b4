"""The tests that are nearest to a module: those that its author would run first."""

import ast
import re
from functools import cache
from pathlib import Path


def nearest(root: Path, source: str) -> tuple[str, ...]:
    """The test files that answer for one source, relative to the root.

    They lie in the folder of `tests/` that mirrors the source's own, or, where that has none, in the next one above it.
    In that folder the files count that are named after the module. Where no file is, the files count that import the
    module, else the files that mention a public name of the module, else all files of the folder.
    """
    module = Path(source).with_suffix("")
    folder = root / "tests" / module.parent
    while not (beside := sorted(folder.glob("test_*.py"))) and folder != root / "tests":
        folder = folder.parent
    if module.name == "__init__":
        module = module.parent
    for answers in (_is_named_after, _imports, _mentions):
        if found := [path for path in beside if answers(path, module, root / source)]:
            return tuple(str(path.relative_to(root)) for path in found)
    return tuple(str(path.relative_to(root)) for path in beside)


def _is_named_after(test: Path, module: Path, source: Path) -> bool:
    return f"_{module.name.strip('_')}_" in f"_{test.stem}_"


def _imports(test: Path, module: Path, source: Path) -> bool:
    whole, package = re.escape(".".join(module.parts)), re.escape(".".join(module.parent.parts))
    one_of = rf"^\s*from {package} import (\([^)]*|[^(\n]*)\b{module.name}\b"
    return bool(re.search(rf"\b{whole}\b(?!\.)", _text(test)) or re.search(one_of, _text(test), re.M))


def _mentions(test: Path, module: Path, source: Path) -> bool:
    return any(re.search(rf"\b{name}\b", _text(test)) for name in _public(source))


@cache
def _public(source: Path) -> tuple[str, ...]:
    if not source.is_file():
        return ()
    defined = (n for n in ast.parse(_text(source)).body if isinstance(n, ast.FunctionDef | ast.ClassDef))
    return tuple(node.name for node in defined if node.name[0] != "_")


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
