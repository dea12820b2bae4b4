"""Verdicts on disk, and when an earlier one still holds.

A mutant keeps its name while the code of its file is the same; comments, docstrings and layout do not count. It stays
caught while the test that caught it is the same, whatever happens to other tests; it stays a survivor while none of the
tests changes.
"""

import ast
import hashlib
import json
from collections import Counter
from pathlib import Path
from typing import Any

from .mutants import Mutant


def fingerprint(*texts: str) -> str:
    """A short name for some texts."""
    return hashlib.blake2b("\0".join(texts).encode(), digest_size=10).hexdigest()


def code(source: str) -> str:
    """A source without comments, docstrings and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        documented = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        if documented and ast.get_docstring(node) is not None:
            node.body = node.body[1:] or [ast.Pass()]
    return ast.unparse(tree)


def keys(file: str, source: str, found: list[Mutant]) -> dict[Mutant, str]:
    """A name for each of all mutants of a source, which says nothing about lines."""
    text, seen, named = code(source), Counter[tuple[str, ...]](), {}
    for mutant in found:
        what = (mutant.function, mutant.kind, " ".join(mutant.before.split()), " ".join(mutant.after.split()))
        named[mutant] = fingerprint(file, text, *what, str(seen[what]))
        seen[what] += 1
    return named


def code_of_test(root: Path, test: str) -> str:
    """A short name for the code of a test function (`file::name[parameters]`); "" if it is not there."""
    file, _, name = test.partition("::")
    path = root / file
    if not path.is_file():
        return ""
    wanted = name.partition("[")[0].split("::")[-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and node.name == wanted:
            return fingerprint(ast.unparse(node))
    return ""


def holds(entry: dict[str, Any], root: Path, tests: str) -> bool:
    """Whether a verdict on the same mutant needs no second look; `tests` names the present tests of its group."""
    if entry["verdict"] == "survived":
        return bool(entry["tests"] == tests)
    return entry["by_code"] == code_of_test(root, entry["by"])


def earlier(path: Path) -> dict[str, dict[str, Any]]:
    """The latest verdict on every mutant, by key."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    entries = [json.loads(line) for line in lines if line.endswith("}")]  # an interrupted run may leave half a line
    return {entry["key"]: entry for entry in entries}
