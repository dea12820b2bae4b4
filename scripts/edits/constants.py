"""Edits of one number in the sources, drawn uniformly over all numbers that stand in them.

A number is an `int` or a `float` that stands in the source of a module, wherever that is: a default, a tolerance, a row
of a table, a pixel of a chart. Left out are those inside formatted strings, whose place Python 3.11 does not know. An
`int` becomes one larger; a `float` 1.5 times as large, and 0.0 becomes 0.5.
"""

import ast
import math
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("novags", "simscenes", "sensor_model")


@dataclass(frozen=True)
class Edit:
    """One number, and what takes its place.

    Attributes:
        file: Relative to the root of the sources.
        line: From 1.
        begin: Of the number in the line, bytes.
        before: The number, as written.
        after: The text written instead.
    """

    file: str
    line: int
    begin: int
    before: str
    after: str

    def applied(self, content: bytes) -> bytes:
        """The content of the file after the edit."""
        lines = content.splitlines(keepends=True)
        line, end = lines[self.line - 1], self.begin + len(self.before)
        assert line[self.begin : end] == self.before.encode()
        lines[self.line - 1] = line[: self.begin] + self.after.encode() + line[end:]
        return b"".join(lines)


def drawn(root: Path, count: int, seed: int) -> list[Edit]:
    """So many different edits of the packages under `root`; more of them begin with the same ones."""
    files = sorted(path for package in PACKAGES for path in (root / package).rglob("*.py"))
    found = [edit for path in files for edit in edits_of(path.relative_to(root).as_posix(), path.read_bytes())]
    random.Random(f"edits {seed}").shuffle(found)
    return found[:count]


def edits_of(file: str, content: bytes) -> Iterator[Edit]:
    """The edits of a file, in the order of its syntax tree."""
    lines = content.splitlines()
    for node in _outside_formats(ast.parse(content)):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            before = lines[node.lineno - 1][node.col_offset : node.end_col_offset].decode()
            yield Edit(file, node.lineno, node.col_offset, before, repr(changed(node.value)))


def changed(value: int | float) -> int | float:
    """The number that takes the place of another one."""
    if isinstance(value, int):
        return value + 1
    larger = 1.5 * value or 0.5
    return larger if math.isfinite(larger) else value / 1.5


def _outside_formats(node: ast.AST) -> Iterator[ast.AST]:
    if not isinstance(node, ast.JoinedStr):
        yield node
        for part in ast.iter_child_nodes(node):
            yield from _outside_formats(part)
