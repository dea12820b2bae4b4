"""What one file of source says: its tokens, what it imports, and which objects it names as text.

Code is compared as tokens, without comments, docstrings, layout and the messages of errors, so that the hash is equal
under every version of Python. The rows of a `Registry` are left out: they are what could be used, not what is.
"""

import ast
import hashlib
import io
import json
import tokenize
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from sensor_model.files.atomic import write_text
from sensor_model.files.own import cache_folder, own_folder
from sensor_model.files.records import read_record

MOST = 4000  # sources that are remembered
SHAPE = {"*": {"tokens": str, "imports": [list], "texts": [str]}}
_SKIPPED = (tokenize.COMMENT, tokenize.NL, tokenize.ENCODING, tokenize.ENDMARKER)
_KINDS = {tokenize.INDENT: ">", tokenize.DEDENT: "<", tokenize.NEWLINE: ";"}


@dataclass(frozen=True)
class Source:
    """What a file of source says.

    Attributes:
        tokens: Hash of the tokens that can change what it computes.
        imports: Modules whose names it imports, with as many dots before them as it writes, and these names; without
            names for `import module`.
        texts: Constants of the form "module:NAME".
    """

    tokens: str
    imports: tuple[tuple[str, tuple[str, ...]], ...]
    texts: tuple[str, ...]


def hashed(content: bytes) -> str:
    """Hash of a content."""
    return hashlib.blake2b(content, digest_size=16).hexdigest()


class Sources:
    """Sources by their content, remembered from one process to the next: reading all takes seconds.

    They lie in a folder that this user alone writes; who has none reads them again.
    """

    def __init__(self) -> None:
        self._known: dict[str, Source] = {}
        self._new = False
        # What is remembered was found by this very code.
        self._name = f"{hashed(Path(__file__).read_bytes())}.json"
        with suppress(OSError, ValueError):
            for key, found in read_record(own_folder(cache_folder("sources")) / self._name, SHAPE).items():
                imports = tuple((module, tuple(names)) for module, names in found["imports"])
                self._known[key] = Source(found["tokens"], imports, tuple(found["texts"]))

    def of(self, content: bytes) -> Source:
        """What a content says.

        Raises:
            SyntaxError: If it is no Python.
        """
        key = hashed(content)
        if key not in self._known:
            self._known[key], self._new = read(content), True
        return self._known[key]

    def remember(self) -> None:
        """Keep what was read for the next process."""
        if self._new:
            kept = dict(list(self._known.items())[-MOST:])
            with suppress(OSError):
                text = json.dumps({key: asdict(source) for key, source in kept.items()})
                write_text(own_folder(cache_folder("sources")) / self._name, text)
            self._new = False


@cache
def sources() -> Sources:
    """Those of this process."""
    return Sources()


def read(content: bytes) -> Source:
    """What a file of source says.

    Raises:
        SyntaxError: If it is no Python.
    """
    imports, texts = list[tuple[str, tuple[str, ...]]](), set[str]()
    for node in _run(ast.parse(content)):
        if isinstance(node, ast.Import):
            imports += [(alias.name, ()) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            imports.append(("." * node.level + (node.module or ""), tuple(alias.name for alias in node.names)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and _is_reference(node.value):
            texts.add(node.value)
    return Source(hashed(" ".join(significant(content)).encode()), tuple(imports), tuple(sorted(texts)))


def _is_reference(text: str) -> bool:
    module, colon, name = text.partition(":")
    return bool(colon) and "." in module and all(part.isidentifier() for part in (*module.split("."), name))


def _run(node: ast.AST) -> Iterator[ast.AST]:
    """Everything that runs: neither the rows of tables nor what only type checkers read."""
    yield node
    parts: Iterable[ast.AST] = ast.iter_child_nodes(node)
    if _is_table(node):
        return
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        parts = node.orelse
    for part in parts:
        yield from _run(part)


def _is_table(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Registry"


def significant(content: bytes) -> Iterator[str]:
    """The tokens of a source that can change what it computes."""
    tables = [((node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset))
              for node in ast.walk(ast.parse(content)) if isinstance(node, ast.Call) and _is_table(node)]  # fmt: skip
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
