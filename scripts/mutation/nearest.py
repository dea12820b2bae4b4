"""The tests that are nearest to a module: those that its author would run first."""

import re
from functools import cache
from pathlib import Path


def nearest(root: Path, source: str) -> tuple[str, ...]:
    """The test files that answer for one source, relative to the root.

    They lie in the folder of `tests/` that mirrors the source's own, or, where that has none, in the next one above it.
    There they are those that are named after the module or that import it; where there are none of these, all of the
    folder.
    """
    module = Path(source).with_suffix("")
    folder = root / "tests" / module.parent
    while not (beside := sorted(folder.glob("test_*.py"))) and folder != root / "tests":
        folder = folder.parent
    if module.name == "__init__":
        module = module.parent
    found = [path for path in beside if _is_named_after(path, module.name) or _imports(path, module)]
    return tuple(str(path.relative_to(root)) for path in found or beside)


def _is_named_after(test: Path, module: str) -> bool:
    return f"_{module.strip('_')}_" in f"_{test.stem}_"


def _imports(test: Path, module: Path) -> bool:
    whole, package = re.escape(".".join(module.parts)), re.escape(".".join(module.parent.parts))
    one_of = rf"^\s*from {package} import (\([^)]*|[^(\n]*)\b{module.name}\b"
    return bool(re.search(rf"\b{whole}\b(?!\.)", _text(test)) or re.search(one_of, _text(test), re.M))


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
