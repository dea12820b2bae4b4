"""What a tired author might have written instead of one expression, with the kind of the mistake."""

import ast
from collections.abc import Iterator
from typing import Any

from .careless import CAMERA_PAIRS, END_PAIRS, Change, careless, name_of
from .relatives import relatives

FLOOR = 1e-5  # smaller constants only keep a division or a logarithm finite
PAIRS = (
    ("height", "width"), ("rows", "columns"), ("y", "x"), ("top", "left"), ("tops", "lefts"), ("down", "right"),
    ("source", "target"), ("warped", "target"), ("noisy", "clean"), ("dark", "clean"),
    ("enhanced", "denoised"), ("enhanced", "clean"), ("prediction", "noisy"), ("origin", "goal"),
    ("camera_t", "camera_s"), ("depth_t", "depth_s"), ("alpha_t", "alpha_s"), ("mx", "my"), ("xx", "yy"),
    ("near", "far"), ("first", "last"), ("start", "stop"), ("forward", "up"), ("mean", "variance"), ("a", "b"),
    *CAMERA_PAIRS, *END_PAIRS,
)  # fmt: skip
PARTNERS = {name: [b if a == name else a for a, b in PAIRS if name in (a, b)] for pair in PAIRS for name in pair}
VIEW_PAIRS = {"source", "target", "warped", "camera_t", "camera_s", "depth_t", "depth_s", "origin", "goal"}
PAIR_KINDS = {frozenset(pair): kind for kind, pairs in (("cameras", CAMERA_PAIRS), ("wrong end", END_PAIRS))
              for pair in pairs}  # fmt: skip
VIEW_INDICES = {"view", "source", "i", "j", "index", "frame"}
TWINS = {
    "extremes": (("min", "max"), ("amin", "amax"), ("minimum", "maximum"), ("clamp_min", "clamp_max"),
                 ("argmin", "argmax"), ("floor", "ceil"), ("any", "all")),
    "activation": (("relu", "leaky_relu"), ("ReLU", "LeakyReLU"), ("max_pool2d", "avg_pool2d"),
                   ("sigmoid", "tanh"), ("Sigmoid", "Tanh")),
    "reduction": (("mean", "sum"), ("std", "var"), ("cumsum", "cumprod")),
    "function": (("sin", "cos"), ("zeros", "ones"), ("new_zeros", "new_ones"), ("log1p", "log"), ("expm1", "exp")),
}  # fmt: skip
TWIN = {a: (kind, b) for kind, pairs in TWINS.items() for pair in pairs for a, b in (pair, pair[::-1])}
DROPPED = {
    "sqrt": "power", "square": "power", "abs": "dropped term", "clamp": "dropped term", "clamp_min": "dropped term",
    "clamp_max": "dropped term", "clip": "dropped term", "log": "power", "exp": "power", "detach": "gradient",
}  # fmt: skip
MODES = {"reflect": "replicate", "replicate": "reflect", "border": "zeros", "bilinear": "bicubic", "edge": "reflect"}
FLIPS = {ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
HARMLESS_OPTIONS = {
    "keepdim", "keepdims", "strict", "exist_ok", "missing_ok", "parents", "copy", "sort_keys", "frozen", "kw_only",
    "set_to_none", "enabled",
}  # fmt: skip


def changes(node: ast.expr, role: str, names: frozenset[str], function: str) -> Iterator[Change]:
    """Mistakes that replace this expression as a whole.

    Args:
        node: The expression.
        role: Its role there: "axis", "index", "slice", "exponent", "callee", "argument", "loop", "option NAME", the
            name that it is given, or "".
        names: Names that the function knows: only those can be mixed up. With them are its `.attributes`, and the whole
            `x.viewmats` and `x.views`.
        function: Its qualified name.
    """
    yield from careless(node, role, names, function)
    yield from relatives(node, role, function)
    match node:
        case ast.BinOp():
            yield from _arithmetic(node)
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(value))) if role in ("axis", "index", "slice"):
            yield "axes", _number(-2 if value == 1 else -1)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield "sign", operand
        case ast.UnaryOp(op=ast.Not() | ast.Invert(), operand=operand):
            yield "condition", operand
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in FLIPS:
            yield "comparison", ast.Compare(left=left, ops=[FLIPS[type(op)]()], comparators=[right])
        case ast.BoolOp(op=op, values=values):
            for i in range(len(values)):
                left_over = [v for j, v in enumerate(values) if j != i]
                yield "condition", left_over[0] if len(left_over) == 1 else ast.BoolOp(op=op, values=left_over)
        case ast.IfExp(body=body, orelse=otherwise):
            yield "condition", body
            yield "condition", otherwise
        case ast.Constant():
            yield from _constant(node.value, role)
        case ast.Attribute(value=value, attr="T" | "mT"):
            yield "axes", value
        case ast.Subscript():
            yield from _subscript(node)
        case ast.Call():
            yield from _call(node)
        case ast.Name(id=name) if role != "callee":
            for partner in PARTNERS.get(name, []):
                if partner in names:
                    yield _pair_kind(name, partner), ast.Name(id=partner)
            if role in ("argument", "index") and name in VIEW_INDICES:
                yield "wrong view", _number(0)


def _arithmetic(node: ast.BinOp) -> Iterator[Change]:
    left, op, right = node.left, node.op, node.right
    texts = (ast.JoinedStr, ast.List, ast.Tuple, ast.Dict, ast.ListComp)
    if any(isinstance(s, texts) or (isinstance(s, ast.Constant) and isinstance(s.value, str)) for s in (left, right)):
        return
    for kind, other in operators(op):
        yield kind, ast.BinOp(left=left, op=other, right=right)
    match op:
        case ast.Add() | ast.Sub():
            half = any(isinstance(s, ast.Constant) and s.value == 0.5 for s in (left, right))
            yield "half a pixel" if half else "dropped term", left
            if isinstance(op, ast.Add) and not half:
                yield "dropped term", right
        case ast.Mult():
            yield "factor", left
            yield "factor", right
        case ast.Div():
            yield "factor", left
        case ast.BitAnd() | ast.BitOr():
            yield "condition", left
            yield "condition", right
        case ast.Pow() if isinstance(right, ast.Constant):
            yield "power", left
        case ast.MatMult():
            yield "axes", ast.BinOp(left=right, op=op, right=left)


def operators(op: ast.operator) -> Iterator[tuple[str, ast.operator]]:
    """What an operator is mixed up with."""
    match op:
        case ast.Add():
            yield "sign", ast.Sub()
        case ast.Sub():
            yield "sign", ast.Add()
        case ast.Mult():
            yield "factor", ast.Div()
        case ast.Div():
            yield "factor", ast.Mult()


def _constant(value: Any, role: str) -> Iterator[Change]:
    if isinstance(value, bool):
        if not role.startswith("option ") or role.removeprefix("option ") not in HARMLESS_OPTIONS:
            yield "option", ast.Constant(value=not value)
    elif isinstance(value, int) and role in ("axis", "index"):
        yield "axes", _number(1 if value == 0 else value - 1)
    elif isinstance(value, int) and role == "slice":
        yield "range", _number(value - 1 if value else 1)
    elif isinstance(value, int | float) and role != "exponent" and (value == 0 or abs(value) >= FLOOR):
        yield "constant", _number({0: 1, 0.5: 1.0, 1: 2, 2: 1}.get(value, 2 * value))
    elif isinstance(value, str) and value in MODES:
        yield "mode", ast.Constant(value=MODES[value])


def _subscript(node: ast.Subscript) -> Iterator[Change]:
    """`x[:, None]` becomes `x[None]`; constants of the index have their own rule."""
    if isinstance(node.slice, ast.Tuple) and len(node.slice.elts) == 2:
        first, last = node.slice.elts
        if isinstance(first, ast.Slice) and isinstance(last, ast.Constant) and last.value is None:
            yield "axes", ast.Subscript(value=node.value, slice=last)


def _call(node: ast.Call) -> Iterator[Change]:
    name, args = name_of(node.func), node.args
    if name in TWIN and not any(k.arg == "count_include_pad" for k in node.keywords):
        kind, other = TWIN[name]
        func = (
            ast.Name(id=other) if isinstance(node.func, ast.Name) else ast.Attribute(value=node.func.value, attr=other)
        )  # type: ignore[attr-defined]
        yield kind, ast.Call(func=func, args=args, keywords=node.keywords)
    if name in DROPPED and isinstance(node.func, ast.Attribute):
        library = isinstance(node.func.value, ast.Name) and node.func.value.id in ("torch", "np", "math", "F")
        yield DROPPED[name], args[0] if library else node.func.value
    if name in ("range", "arange") and args:
        at = min(1, len(args) - 1)
        less = ast.BinOp(left=args[at], op=ast.Sub(), right=_number(1))
        yield "range", ast.Call(func=node.func, args=[*args[:at], less, *args[at + 1 :]], keywords=node.keywords)
    if name == "linspace" and len(args) > 2:
        less = ast.BinOp(left=args[2], op=ast.Add(), right=_number(1))
        yield "range", ast.Call(func=node.func, args=[*args[:2], less, *args[3:]], keywords=node.keywords)
    for i, (a, b) in enumerate(zip(args[:-1], args[1:], strict=True)):
        if name_of(b) in PARTNERS.get(name_of(a), []):
            kind = _pair_kind(name_of(a), name_of(b))
            yield kind, ast.Call(func=node.func, args=[*args[:i], b, a, *args[i + 2 :]], keywords=node.keywords)


def _pair_kind(a: str, b: str) -> str:
    return PAIR_KINDS.get(frozenset((a, b)), "wrong view" if a in VIEW_PAIRS else "axes")


def _number(value: float) -> ast.expr:
    return ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=-value)) if value < 0 else ast.Constant(value=value)
