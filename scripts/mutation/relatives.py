"""Other forms of the careless mistakes, at the places where `careless.py` puts its own.

Tests were written against the forms there; these say whether the tests notice the place or only that form.

- identity, seed: one part twice, in the place of its neighbour
- only the first: only the last, or all but the first
- colour matrix: applied twice
- wrong end: the value next to the end, the median, or whichever of two bounds comes first
- gain: left out, or applied twice
"""

import ast
from collections.abc import Iterator

from .careless import GAIN, IDENTITIES, KEYS, MAKES_IDENTITY, SIGNAL, Change, name_of


def relatives(node: ast.expr, role: str, function: str) -> Iterator[Change]:
    """Such mistakes that replace this expression as a whole; the arguments as in `rules.changes`."""
    if MAKES_IDENTITY.search(function.split(".")[-1]) or role in KEYS:
        yield from (("identity", part) for part in _repeating_a_part(node))
    match node:
        case ast.Call():
            yield from _call(node)
        case ast.Name() | ast.Attribute() if role == "option seed" or (role == "argument" and name_of(node) == "seed"):
            yield "seed", ast.Constant(value=1)
        case ast.Name() | ast.Attribute() if role == "loop" and name_of(node).endswith("s"):
            every = ast.Call(func=ast.Name(id="list"), args=[node], keywords=[])
            yield "only the first", ast.Subscript(value=every, slice=ast.Slice(lower=_minus_one()))
            yield "only the first", ast.Subscript(value=every, slice=ast.Slice(lower=ast.Constant(value=1)))
        case ast.BinOp(left=left, op=ast.MatMult() as op, right=right) if "matrix" in ast.unparse(right):
            yield "colour matrix", ast.BinOp(left=ast.BinOp(left=left, op=op, right=right), op=op, right=right)
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right) if GAIN.search(name_of(right)):
            yield "gain", left
            yield "gain", ast.BinOp(left=ast.BinOp(left=left, op=op, right=right), op=op, right=right)
        case ast.BinOp(left=left, op=ast.Mult() as op, right=right) if GAIN.search(name_of(left)):
            yield "gain", right
            yield "gain", ast.BinOp(left=left, op=op, right=ast.BinOp(left=left, op=op, right=right))
        case ast.Subscript(value=value, slice=ast.Constant(value=0)) if SIGNAL.search(name_of(value)):
            yield "wrong end", ast.Subscript(value=value, slice=ast.Constant(value=1))


def _minus_one() -> ast.expr:
    return ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=1))


def _call(node: ast.Call) -> Iterator[Change]:
    name, args = name_of(node.func), node.args
    if name in IDENTITIES:
        for other in _each_repeated(args):
            yield "identity", ast.Call(func=node.func, args=other, keywords=node.keywords)
    for i, arg in enumerate(args):
        if name in IDENTITIES or (name == "once" and i == 0):
            for part in _repeating_a_part(arg):
                yield (
                    "identity",
                    ast.Call(func=node.func, args=[*args[:i], part, *args[i + 1 :]], keywords=node.keywords),
                )
        if name in ("default_rng", "SeedSequence") and isinstance(arg, ast.List | ast.Tuple):
            for parts in _each_repeated(arg.elts):
                other = [*args[:i], ast.List(elts=parts), *args[i + 1 :]]
                yield "seed", ast.Call(func=node.func, args=other, keywords=node.keywords)
    text = " ".join(ast.unparse(arg) for arg in args)
    if name in ("min", "max", "minimum", "maximum") and len(args) == 2 and SIGNAL.search(text):
        yield from (("wrong end", arg) for arg in args if not isinstance(arg, ast.Starred))
    if name == "quantile" and len(args) == 2 and not isinstance(args[1], ast.Tuple):
        middle = [args[0], ast.Constant(value=0.5)]
        yield "wrong end", ast.Call(func=node.func, args=middle, keywords=node.keywords)


def _each_repeated(parts: list[ast.expr]) -> Iterator[list[ast.expr]]:
    """Every part in turn gives way to the one before it, the first part to the second; constants stay."""
    for i, part in enumerate(parts if len(parts) > 1 else []):
        if not isinstance(part, ast.Constant | ast.Starred):
            yield [*parts[:i], parts[i - 1 if i else 1], *parts[i + 1 :]]


def _repeating_a_part(node: ast.expr) -> Iterator[ast.expr]:
    """A dictionary, a list, a tuple, a sum or a formatted text that has one part twice."""
    match node:
        case ast.Dict(keys=keys, values=values):
            yield from (ast.Dict(keys=keys, values=other) for other in _each_repeated(values))
        case ast.List(elts=parts) | ast.Tuple(elts=parts):
            yield from (type(node)(elts=other, ctx=ast.Load()) for other in _each_repeated(parts))
        case ast.BinOp(left=left, op=ast.Add() as op, right=right):
            yield from (ast.BinOp(left=a, op=op, right=b) for a, b in _each_repeated([left, right]))
            yield from (ast.BinOp(left=part, op=op, right=right) for part in _repeating_a_part(left))
            yield from (ast.BinOp(left=left, op=op, right=part) for part in _repeating_a_part(right))
        case ast.Call(func=ast.Attribute(value=ast.JoinedStr(values=parts), attr="encode"), args=[]):
            places = [i for i, part in enumerate(parts) if isinstance(part, ast.FormattedValue)]
            for shown in _each_repeated([parts[i] for i in places]):
                swapped = dict(zip(places, shown, strict=True))
                text = ast.JoinedStr(values=[swapped.get(i, part) for i, part in enumerate(parts)])
                yield ast.Call(func=ast.Attribute(value=text, attr="encode"), args=[], keywords=[])
        case ast.Lambda(args=args, body=body):
            yield from (ast.Lambda(args=args, body=part) for part in _repeating_a_part(body))
