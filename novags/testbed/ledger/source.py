"""The content of one file of source: its definitions, their tokens, and the names each of them uses.

A definition is a statement at the top of a module. Code is compared as tokens, without comments, docstrings, layout and
the messages of errors, so that the hash is equal under every version of Python. The rows of a `Registry` are left out:
they are code that could be used, not code in use.
"""

import ast
import hashlib
import io
import json
import tokenize
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeGuard

from sensor_model.files.atomic import write_text
from sensor_model.files.own import cache_folder, own_folder
from sensor_model.files.records import check_shape, parse_json, read_record

MOST = 4000  # sources that are remembered
SHAPE = {"definitions": [{"names": [str], "runs": bool, "tokens": str, "uses": [str], "reaches": [[str]]}],
         "imports": {"*": [str]}, "loads": [[str]]}  # fmt: skip
# Decorators that wrap a function and do nothing else. Any other may enter it in a table, as numba's register_model
# does, so that it runs though nobody names it.
WRAPPERS = frozenset({"cache", "contextmanager", "dataclass", "fast", "inline", "intrinsic", "jit", "kernel",
                      "lru_cache", "no_grad", "partial", "remembered", "runtime_checkable"})  # fmt: skip
_SKIPPED = (tokenize.COMMENT, tokenize.NL, tokenize.ENCODING, tokenize.ENDMARKER)
_KINDS = {tokenize.INDENT: ">", tokenize.DEDENT: "<", tokenize.NEWLINE: ";"}


@dataclass(frozen=True)
class Definition:
    """A statement at the top of a module.

    Attributes:
        names: The names it binds.
        runs: Whether it does more than to bind names, so that it counts wherever its module is imported.
        tokens: Hash of the tokens that can change its results.
        uses: Names of the module that it reads, with their attributes: "name", "name.attribute".
        reaches: Module and name of its own imports, and of definitions it names as text, "module:NAME"; the module with
            as many dots before it as are written, and "" as the name of a whole module.
    """

    names: tuple[str, ...]
    runs: bool
    tokens: str
    uses: tuple[str, ...]
    reaches: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class SourceCode:
    """What a file of source says.

    Attributes:
        definitions: In their order.
        imports: Module and name of each name that is imported at the top; as in `Definition.reaches`.
        loads: The same of all that these statements load; name "*" of all names of a module.
    """

    definitions: tuple[Definition, ...]
    imports: dict[str, tuple[str, str]]
    loads: tuple[tuple[str, str], ...]


def hashed(content: bytes) -> str:
    """Hash of a content."""
    return hashlib.blake2b(content, digest_size=16).hexdigest()


class Sources:
    """Sources by their content, remembered from one process to the next: reading all takes seconds.

    They lie in a folder that this user alone writes; who has none reads them again.
    """

    def __init__(self) -> None:
        self._known: dict[str, SourceCode] = {}
        self._texts: dict[str, str] = {}  # of the same and of more, each parsed when it is asked for
        self._new = False
        # Remembered results were found by this very code.
        self._name = f"{hashed(Path(__file__).read_bytes())}.json"
        with suppress(OSError, ValueError):
            self._texts = read_record(own_folder(cache_folder("sources")) / self._name, {"*": str})

    def of(self, content: bytes) -> SourceCode:
        """The analysis of a content.

        Raises:
            SyntaxError: If it is no Python.
        """
        key = hashed(content)
        if key not in self._known:
            self._known[key] = self._remembered(key) or self._read(key, content)
        return self._known[key]

    def _read(self, key: str, content: bytes) -> SourceCode:
        found = read(content)
        self._texts[key], self._new = json.dumps(asdict(found)), True
        return found

    def _remembered(self, key: str) -> SourceCode | None:
        with suppress(ValueError):
            if (text := self._texts.get(key)) is not None:
                return _source(parse_json(text, "a source that is remembered"))
        return None

    def remember(self) -> None:
        """Keep the analysis for the next process."""
        if self._new:
            with suppress(OSError):
                text = json.dumps(dict(list(self._texts.items())[-MOST:]))
                write_text(own_folder(cache_folder("sources")) / self._name, text)
            self._new = False


@cache
def sources() -> Sources:
    """The sources of this process."""
    return Sources()


def _source(found: Any) -> SourceCode:
    """A source from the cache.

    Raises:
        ValueError: If it is not a kept source.
    """
    check_shape(found, SHAPE, "a source that is remembered", "remove it")

    def pairs(values: Iterable[list[str]]) -> tuple[tuple[str, str], ...]:
        return tuple((module, name) for module, name in values)

    definitions = tuple(
        Definition(tuple(one["names"]), one["runs"], one["tokens"], tuple(one["uses"]), pairs(one["reaches"]))
        for one in found["definitions"]
    )
    return SourceCode(definitions, dict(zip(found["imports"], pairs(found["imports"].values()), strict=True)),
                  pairs(found["loads"]))  # fmt: skip


def read(content: bytes) -> SourceCode:
    """What a file of source says.

    Raises:
        SyntaxError: If it is no Python.
    """
    lines = content.splitlines(keepends=True)
    definitions, imports, loads = list[Definition](), dict[str, tuple[str, str]](), list[tuple[str, str]]()
    for statement in ast.parse(content).body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            loads += _imported(statement)
            imports |= _bound_by(statement)
        elif not _says_nothing(statement):
            definitions.append(_definition(statement, lines))
    known = {*imports, *(name for one in definitions for name in one.names)}
    kept = (replace(one, uses=tuple(use for use in one.uses if use.partition(".")[0] in known)) for one in definitions)
    return SourceCode(tuple(kept), imports, tuple(loads))


def _definition(statement: ast.stmt, lines: list[bytes]) -> Definition:
    names, runs = _bound(statement)
    uses, reaches = set[str](), set[tuple[str, str]]()
    for node in _run(statement):
        if isinstance(node, ast.Name | ast.Attribute):
            uses.add(ast.unparse(node))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            reaches.update(_imported(node))
        elif isinstance(node, ast.Constant):
            module, _, name = str(node.value).partition(":")
            reaches.add((module, name))
    first = min(node.lineno for node in (statement, *getattr(statement, "decorator_list", ())))
    tokens = hashed(" ".join(significant(b"".join(lines[first - 1 : statement.end_lineno]))).encode())
    return Definition(tuple(sorted(names)), runs, tokens, tuple(sorted(uses)), tuple(sorted(reaches)))


def _bound(statement: ast.stmt) -> tuple[set[str], bool]:
    """The names that a statement binds, and whether it does more than that.

    An assignment to names counts where these names are read: by our convention, the functions it calls do nothing but
    return a value. An assignment to a part of something, a loop, a call or a condition counts always.
    """
    # A function that assigns to a name of the module decides on the value that others read there.
    names = {name for node in ast.walk(statement) if isinstance(node, ast.Global) for name in node.names}
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return {*names, statement.name}, not all(_wraps(decorator) for decorator in statement.decorator_list)
    stored = {node.id for node in ast.walk(statement) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    if isinstance(statement, ast.Assign | ast.AnnAssign):
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        parts = [part for target in targets for part in getattr(target, "elts", [target])]
        return names | stored, not all(isinstance(part, ast.Name) for part in parts)
    imported = (_bound_by(node) for node in ast.walk(statement) if isinstance(node, ast.Import | ast.ImportFrom))
    defined = {node.name for node in ast.walk(statement) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    return names.union(stored, defined, *imported), True


def _wraps(decorator: ast.expr) -> bool:
    """Whether a decorator does no more than to wrap."""
    name = decorator.func if isinstance(decorator, ast.Call) else decorator
    return ast.unparse(name).rpartition(".")[2] in WRAPPERS


def _imported(statement: ast.Import | ast.ImportFrom) -> list[tuple[str, str]]:
    """Module and name of everything that an import loads."""
    if isinstance(statement, ast.Import):
        return [(alias.name, "") for alias in statement.names]
    module = "." * statement.level + (statement.module or "")
    return [(module, alias.name) for alias in statement.names]


def _bound_by(statement: ast.Import | ast.ImportFrom) -> dict[str, tuple[str, str]]:
    """The object behind each name that an import binds."""
    found = {}
    for alias, (module, name) in zip(statement.names, _imported(statement), strict=True):
        if name or alias.asname:
            found[alias.asname or name] = (module, name)
        else:  # `import a.b` binds a
            first = module.partition(".")[0]
            found[first] = (first, "")
    return found


def _is_reference(text: str) -> bool:
    module, colon, name = text.partition(":")
    return bool(colon) and "." in module and all(part.isidentifier() for part in (*module.split("."), name))


def _run(node: ast.AST) -> Iterator[ast.AST]:
    """Code that may reach something, of all that runs: imports, references as text, names with all their attributes."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        yield node
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, str) and _is_reference(node.value):
            yield node
    elif _is_table(node):
        yield node.func
    elif isinstance(node, ast.Name) or _is_dotted(node):
        yield node
    else:
        parts = node.orelse if _is_for_checkers(node) else ast.iter_child_nodes(node)
        for part in parts:
            yield from _run(part)


def _is_dotted(node: ast.AST) -> bool:
    """Whether it is a name with attributes, such as `a.b.c`."""
    while isinstance(node, ast.Attribute):
        node = node.value
    return isinstance(node, ast.Name)


def _says_nothing(node: ast.stmt) -> bool:
    """Whether it is a docstring, or for type checkers alone."""
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant)
    return _is_for_checkers(node) and not node.orelse


def _is_for_checkers(node: ast.AST) -> TypeGuard[ast.If]:
    """Whether its first branch is read by type checkers alone."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _is_table(node: ast.AST) -> TypeGuard[ast.Call]:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Registry"


def significant(content: bytes) -> Iterator[str]:
    """The tokens of a source that can change its results."""
    tree = ast.parse(content) if b"Registry" in content else ast.Module([], [])
    tables = [((node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset))
              for node in ast.walk(tree) if _is_table(node)]  # fmt: skip
    lines = content.decode("utf-8-sig").splitlines(keepends=True)
    statement: list[tuple[int, str]] = []
    for kind, text, place in _tokens(content, lines):
        if any(begin < place < end for begin, end in tables):
            continue
        if kind not in _KINDS:
            statement.append((kind, text))
            continue
        if kind == tokenize.NEWLINE:
            kept, statement = _kept(statement), []
            if not kept:
                continue
            yield from kept
        yield _KINDS[kind]


def _kept(statement: list[tuple[int, str]]) -> list[str]:
    """A statement; nothing of a docstring, and of an error that is raised its kind alone."""
    texts = [text for _, text in statement]
    if all(kind == tokenize.STRING for kind, _ in statement):
        return []
    return texts[: texts.index("(")] if texts[0] == "raise" and "(" in texts else texts


def _tokens(content: bytes, lines: list[str]) -> Iterator[tuple[int, str, tuple[int, int]]]:
    """Kind, text and place of every token; a formatted string, which Python 3.12 takes apart, is one again."""
    start, end = (getattr(tokenize, f"FSTRING_{part}", -1) for part in ("START", "END"))
    depth, begin = 0, (0, 0)
    for kind, text, first, last, _ in tokenize.tokenize(io.BytesIO(content).readline):
        if kind == start:
            depth, begin = depth + 1, begin if depth else first
        elif kind == end:
            depth -= 1
            if not depth:
                yield tokenize.STRING, _between(lines, begin, last), begin
        elif not depth and kind not in _SKIPPED:
            yield kind, text, first


def _between(lines: list[str], begin: tuple[int, int], end: tuple[int, int]) -> str:
    """The text from one place to another; lines count from 1."""
    whole = lines[begin[0] - 1 : end[0]]
    whole[-1] = whole[-1][: end[1]]
    whole[0] = whole[0][begin[1] :]
    return "".join(whole)
