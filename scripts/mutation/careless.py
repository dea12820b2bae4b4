"""Mistakes that small tests hide: of one view, of gain 1, of one seed, of the identity as colour matrix.

- identity: a hash, or a key of a memo, that lacks one of its parts: something else is taken for the same
- seed: a seed that does not reach what it should vary
- only the first: of several exposures, neighbours, views
- colour matrix: left out, or not transposed
- cameras: given ones where refined ones are meant, estimated ones where true ones are, and the reverse
- wrong end: a bound taken at the bright end where the dark end is meant, and the reverse
- gain: a gain, an exposure or a scale upside down
"""

import ast
import re
from collections.abc import Iterator

Change = tuple[str, ast.expr]  # kind, what stands there instead

CARELESS = ("identity", "seed", "only the first", "colour matrix", "cameras", "wrong end", "gain")
CAMERA_PAIRS = (
    ("given", "refined"), ("known", "estimated"), ("viewmats", "refined"), ("true", "estimated"),
    ("viewmats_true", "viewmats_estimated"),
)  # fmt: skip
END_PAIRS = (("low", "high"), ("dark", "bright"), ("darkest", "brightest"), ("black", "white"))
# Functions all of whose parts count, and the names of values that become a key.
IDENTITIES = {"digest", "key_of", "identity", "fingerprint", "content_of", "job_digest", "hashed", "folder_digest",
              "sha256", "blake2b"}  # fmt: skip
MAKES_IDENTITY = re.compile(r"(^|_)(identity|digest|key|fingerprint|hashed)(_of)?$")
KEYS = {"key", "identity", "recipe", "inputs", "option identity", "option inputs"}
SIGNAL = re.compile(r"signal|electron|mu_e|\bdn\b|light|radiance|dark|bright|level|variance|noise|gain|exposure|white")
GAIN = re.compile(r"(gain|exposure|scale)$")


def careless(node: ast.expr, role: str, names: frozenset[str], function: str) -> Iterator[Change]:
    """Such mistakes that replace this expression as a whole; the arguments as in `rules.changes`."""
    if MAKES_IDENTITY.search(function.split(".")[-1]) or role in KEYS:
        yield from (("identity", part) for part in _lacking_a_part(node))
    match node:
        case ast.Call():
            yield from _call(node)
        case ast.Name() | ast.Attribute() if role == "option seed" or (role == "argument" and name_of(node) == "seed"):
            yield "seed", ast.Constant(value=0)
        case ast.Name() | ast.Attribute() if role == "loop" and name_of(node).endswith("s"):
            first = ast.Call(func=ast.Name(id="list"), args=[node], keywords=[])  # of sets and dictionaries too
            yield "only the first", ast.Subscript(value=first, slice=ast.Slice(upper=ast.Constant(value=1)))
        case ast.Attribute(value=value, attr="T") if "matrix" in name_of(value):
            yield "colour matrix", value
        case ast.BinOp():
            yield from _arithmetic(node)
        case ast.Subscript(value=value, slice=index) if SIGNAL.search(name_of(value)):
            yield from (("wrong end", ast.Subscript(value=value, slice=other)) for other in _other_end(index))
    if isinstance(node, ast.Attribute) and role != "callee":
        yield from _attribute(node, names)


def _call(node: ast.Call) -> Iterator[Change]:
    name, args = name_of(node.func), node.args
    whole = name in IDENTITIES and len(args) > 1
    for i, arg in enumerate(args):
        before, after = args[:i], args[i + 1 :]
        if whole:
            yield "identity", ast.Call(func=node.func, args=before + after, keywords=node.keywords)
        if name in IDENTITIES or (name == "once" and i == 0):
            for part in _lacking_a_part(arg):
                yield "identity", ast.Call(func=node.func, args=[*before, part, *after], keywords=node.keywords)
        if name in ("default_rng", "SeedSequence") and isinstance(arg, ast.List | ast.Tuple):
            for k, part in enumerate(arg.elts):
                if not isinstance(part, ast.Constant):  # without a number that is always the same, no draw is shared
                    rest = ast.List(elts=arg.elts[:k] + arg.elts[k + 1 :])
                    yield "seed", ast.Call(func=node.func, args=[*before, rest, *after], keywords=node.keywords)
    text = " ".join(ast.unparse(arg) for arg in args) if args else ast.unparse(node.func)
    for a, b in (("min", "max"), ("amin", "amax"), ("minimum", "maximum"), ("argmin", "argmax")):
        if name in (a, b) and SIGNAL.search(text):
            yield (
                "wrong end",
                ast.Call(func=_renamed(node.func, b if name == a else a), args=args, keywords=node.keywords),
            )
    if name == "quantile" and len(args) == 2:
        far = ast.BinOp(left=ast.Constant(value=1), op=ast.Sub(), right=args[1])
        if not isinstance(args[1], ast.Tuple):
            yield "wrong end", ast.Call(func=node.func, args=[args[0], far], keywords=node.keywords)
    if name == "replace" and len(args) == 1 and any(k.arg == "viewmats" for k in node.keywords):
        yield "cameras", args[0]


def _arithmetic(node: ast.BinOp) -> Iterator[Change]:
    left, right = node.left, node.right
    match node.op:
        case ast.MatMult() if "matrix" in ast.unparse(right):
            yield "colour matrix", left
        case ast.Add():
            yield from (("seed", side) for side in (left, right) if name_of(side) == "seed")
        case ast.Mult() | ast.Div() if any(GAIN.search(name_of(side)) for side in (left, right)):
            other = ast.Div() if isinstance(node.op, ast.Mult) else ast.Mult()
            yield "gain", ast.BinOp(left=left, op=other, right=right)


def _attribute(node: ast.Attribute, names: frozenset[str]) -> Iterator[Change]:
    """An attribute of the same object, or of another one, that the function knows as well."""
    for kind, pairs in (("wrong end", END_PAIRS), ("cameras", CAMERA_PAIRS)):
        for pair in pairs:
            if node.attr in pair:
                partner = pair[1 - pair.index(node.attr)]
                if f".{partner}" in names:
                    yield kind, ast.Attribute(value=node.value, attr=partner)
    if node.attr in ("viewmats", "views"):
        own = ast.unparse(node)
        for other in sorted(name for name in names if name.endswith(f".{node.attr}") and name[0] != "."):
            if other != own:
                yield "cameras", ast.parse(other, mode="eval").body


def _lacking_a_part(node: ast.expr) -> Iterator[ast.expr]:
    """A dictionary, a list, a tuple or a sum of several parts, or a function that gives one, without one of them."""
    match node:
        case ast.Dict(keys=keys, values=values) if len(keys) > 1:
            for i in range(len(keys)):
                yield ast.Dict(keys=[*keys[:i], *keys[i + 1 :]], values=[*values[:i], *values[i + 1 :]])
        case ast.List(elts=parts) | ast.Tuple(elts=parts) if len(parts) > 1:
            for i in range(len(parts)):
                yield type(node)(elts=[*parts[:i], *parts[i + 1 :]], ctx=ast.Load())
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            yield left
            yield right
            yield from (ast.BinOp(left=part, op=ast.Add(), right=right) for part in _lacking_a_part(left))
            yield from (ast.BinOp(left=left, op=ast.Add(), right=part) for part in _lacking_a_part(right))
        case ast.Call(func=ast.Attribute(value=ast.JoinedStr(values=parts), attr="encode"), args=[]):
            shown = [part for part in parts if isinstance(part, ast.FormattedValue)]
            for part in shown if len(shown) > 1 else []:
                text = ast.JoinedStr(values=[other for other in parts if other is not part])
                yield ast.Call(func=ast.Attribute(value=text, attr="encode"), args=[], keywords=[])
        case ast.Lambda(args=args, body=body):
            for part in _lacking_a_part(body):
                yield ast.Lambda(args=args, body=part)


def _other_end(index: ast.expr) -> Iterator[ast.expr]:
    """The last place for the first, and the reverse."""
    match index:
        case ast.Constant(value=0):
            yield ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=1))
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=1)):
            yield ast.Constant(value=0)


def _renamed(func: ast.expr, name: str) -> ast.expr:
    return ast.Attribute(value=func.value, attr=name) if isinstance(func, ast.Attribute) else ast.Name(id=name)


def name_of(node: ast.expr) -> str:
    """The name or attribute that an expression ends in; "" for any other expression."""
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
