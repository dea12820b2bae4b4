"""All plausible mistakes in a Python source, found by the rules.

Left alone are docstrings, annotations, decorators, imports, messages, `raise` and the tests that guard it,
`__post_init__`, and floors below 1e-5, whose factor of two nobody can observe.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from .careless import name_of
from .rules import changes, operators

AXIS_METHODS = {
    "sum", "mean", "std", "var", "amax", "amin", "max", "min", "any", "all", "cumsum", "movedim", "unsqueeze",
    "squeeze", "flatten", "cat", "stack", "argsort", "argmax", "argmin", "swapaxes", "moveaxis",
}  # fmt: skip
SILENT = {"print", "warn", "progress", "info", "debug", "add_argument"}


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """One mistake: `before` becomes `after`, at bytes start..end of the source."""

    kind: str
    function: str  # qualified name; "" at module level
    line: int
    lines: tuple[int, int]  # first and last line of the statement, or of its head, that evaluates the expression
    imported: bool  # evaluated when the module is imported
    before: str
    after: str
    start: int
    end: int

    def apply(self, source: str) -> str:
        """The source with the mistake in it; all other lines keep their numbers."""
        raw = source.encode()
        return (raw[: self.start] + self.after.encode() + raw[self.end :]).decode()


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Where in the file the walk is."""

    function: str = ""
    names: frozenset[str] = frozenset()
    lines: tuple[int, int] = (0, 0)
    imported: bool = True


def mutants(source: str) -> list[Mutant]:
    """All mistakes that the rules know of, in the order of the source, none twice."""
    raw, offsets = source.encode(), [0]
    for line in raw.splitlines(keepends=True):
        offsets.append(offsets[-1] + len(line))
    found: dict[tuple[int, int, str], Mutant] = {}
    for kind, node, after, place in _statements(ast.parse(source).body, _Place()):
        start = offsets[node.lineno - 1] + node.col_offset
        end = offsets[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
        before = raw[start:end].decode()
        # The line breaks of the replaced text stay, so that no later line moves.
        breaks = "\n" * before.count("\n")
        code = f"({ast.unparse(after)}{breaks})" if isinstance(after, ast.expr) else ast.unparse(after) + breaks
        if ast.unparse(after) != ast.unparse(node):
            found.setdefault((start, end, code), Mutant(
                kind=kind, function=place.function, line=node.lineno, lines=place.lines, imported=place.imported,
                before=before, after=code, start=start, end=end,
            ))  # fmt: skip
    return sorted(found.values(), key=lambda m: (m.start, m.end, m.after))


def _statements(body: list[ast.stmt], place: _Place) -> Iterator[tuple[str, Any, Any, _Place]]:
    for node in body:
        at = replace(place, lines=(node.lineno, node.end_lineno or node.lineno))
        match node:
            case ast.FunctionDef(name="__post_init__"):
                pass
            case ast.FunctionDef() | ast.ClassDef():
                yield from _definition(node, at)
            case ast.If(test=test, body=inside, orelse=otherwise):
                if not all(isinstance(s, ast.Raise) for s in inside):
                    yield from _expression(test, _head(at, test))
                yield from _statements(inside + otherwise, place)
            case ast.For(iter=over) | ast.While(test=over):
                yield from _expression(over, _head(at, over), "loop" if isinstance(node, ast.For) else "")
                yield from _statements(node.body + node.orelse, place)
            case ast.With():
                for item in node.items:
                    yield from _expression(item.context_expr, _head(at, item.context_expr))
                yield from _statements(node.body, place)
            case ast.Try():
                yield from _statements(node.body + node.orelse + node.finalbody, place)
                for handler in node.handlers:
                    yield from _statements(handler.body, place)
            case ast.Expr(value=ast.Call(func=func)) if name_of(func) not in SILENT:
                yield "dropped step", node, ast.Pass(), at
                yield from _expression(node.value, at)
            case ast.AugAssign(op=op):
                for kind, other in operators(op):
                    yield kind, node, ast.AugAssign(target=node.target, op=other, value=node.value), at
                yield "dropped step", node, ast.Pass(), at
                yield from _expression(node.value, at)
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                yield from _expression(value, at, name)
            case ast.Assign(value=value) | ast.AnnAssign(value=value) | ast.Return(value=value) if value is not None:
                yield from _expression(value, at)


def _definition(node: ast.FunctionDef | ast.ClassDef, place: _Place) -> Iterator[tuple[str, Any, Any, _Place]]:
    function = f"{place.function}.{node.name}".lstrip(".")
    if isinstance(node, ast.ClassDef):
        yield from _statements(node.body, replace(place, function=function))
        return
    for default in [*node.args.defaults, *(d for d in node.args.kw_defaults if d is not None)]:
        yield from _expression(default, replace(place, function=function, lines=(node.lineno, node.lineno)))
    names = place.names | _names(node)
    yield from _statements(node.body, _Place(function=function, names=names, imported=False))


def _names(function: ast.FunctionDef) -> frozenset[str]:
    """What a function knows, as `rules.changes` takes it."""
    ids = {n.id for n in ast.walk(function) if isinstance(n, ast.Name)}
    arguments = {n.arg for n in ast.walk(function.args) if isinstance(n, ast.arg)}
    attributes = [n for n in ast.walk(function) if isinstance(n, ast.Attribute)]
    cameras = {ast.unparse(n) for n in attributes if n.attr in ("viewmats", "views")}
    return frozenset(ids | arguments | {f".{n.attr}" for n in attributes} | cameras)


def _head(place: _Place, test: ast.expr) -> _Place:
    return replace(place, lines=(place.lines[0], test.end_lineno or test.lineno))


def _expression(node: ast.expr, place: _Place, role: str = "") -> Iterator[tuple[str, Any, Any, _Place]]:
    """Changes of an expression and all inside. `role` says what a constant is there for."""
    if isinstance(node, ast.JoinedStr):
        return
    for kind, after in changes(node, role, place.names, place.function):
        yield kind, node, after, place
    for child, its_role in _children(node, role):
        yield from _expression(child, place, its_role)


def _children(node: ast.expr, role: str) -> Iterator[tuple[ast.expr, str]]:
    match node:
        case ast.Call(func=func, args=args, keywords=keywords):
            yield func, "callee"
            axis = isinstance(func, ast.Attribute) and func.attr in AXIS_METHODS
            stacked = name_of(func) in ("cat", "stack", "concatenate")
            for i, arg in enumerate(args):
                yield arg, "axis" if axis and (i > 0 or not stacked) else "argument"
            for keyword in keywords:
                yield keyword.value, "axis" if keyword.arg in ("dim", "axis") else f"option {keyword.arg}"
        case ast.Subscript(value=value, slice=index):
            yield value, ""
            yield index, "index"
        case ast.Tuple(elts=elements):
            for element in elements:
                yield element, role
        case ast.Slice():
            for bound in (node.lower, node.upper):
                if bound is not None:
                    yield bound, "slice"
        case ast.UnaryOp(operand=ast.Constant()) if role in ("axis", "index", "slice"):
            return
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            yield left, ""
            yield right, "exponent"
        case _:
            for child in ast.iter_child_nodes(node):
                if isinstance(child, ast.comprehension):
                    yield child.iter, "loop"
                    yield from ((condition, "") for condition in child.ifs)
                elif isinstance(child, ast.expr):
                    yield child, ""
