"""Vectors of sixteen float32 for numba kernels: one AVX-512 register, two AVX2, four NEON.

Numba's own vectoriser gives up on loops with early exits, several accumulators or a reduction, which compositing is
made of (measured: 5 to 10 times slower). A `floats` value supports + - * / with itself and float32, comparisons give a
`mask`. All functions but the operators are for use inside kernels only.
"""

# mypy: allow-untyped-defs

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.errors import TypingError
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from ..compiler import FLAGS, inline

LANES = 16
_F32, _I1, _I32, _I64 = ir.FloatType(), ir.IntType(1), ir.IntType(32), ir.IntType(64)
_VEC, _BITS, _INTS = (ir.VectorType(scalar, LANES) for scalar in (_F32, _I1, _I32))


class _Vector(types.Type):
    def __init__(self, name: str, ir_type: ir.VectorType) -> None:
        self.ir_type = ir_type
        super().__init__(name=name)


floats = _Vector("float32x16", _VEC)
mask = _Vector("mask16", _BITS)


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: _Vector) -> None:
        super().__init__(dmm, fe_type, fe_type.ir_type)


def _spread(builder: Any, value: Any) -> Any:
    """A scalar in all lanes; vectors pass."""
    if isinstance(value.type, ir.VectorType):
        return value
    vector = ir.VectorType(value.type, LANES)
    undefined = ir.Constant(vector, ir.Undefined)
    single = builder.insert_element(undefined, value, ir.Constant(_I32, 0))
    return builder.shuffle_vector(single, undefined, ir.Constant(_INTS, [0] * LANES))


def _define(op: Callable[..., Any], emit: Callable[..., Any], result: _Vector, operands: list[tuple[Any, ...]]) -> None:
    """Teach numba a Python operator on vectors."""
    signatures = [signature(result, *types_) for types_ in operands]

    @infer_global(op)
    class _Template(ConcreteTemplate):
        cases = signatures

    for case in signatures:

        @lower_builtin(op, *case.args)
        def _lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return emit(builder, *(_spread(builder, value) for value in args))


_PAIRS: list[tuple[Any, ...]] = [(floats, floats), (floats, types.float32), (types.float32, floats)]
_define(operator.add, lambda b, x, y: b.fadd(x, y, flags=FLAGS), floats, _PAIRS)
_define(operator.iadd, lambda b, x, y: b.fadd(x, y, flags=FLAGS), floats, _PAIRS[:2])
_define(operator.sub, lambda b, x, y: b.fsub(x, y, flags=FLAGS), floats, _PAIRS)
_define(operator.isub, lambda b, x, y: b.fsub(x, y, flags=FLAGS), floats, _PAIRS[:2])
_define(operator.mul, lambda b, x, y: b.fmul(x, y, flags=FLAGS), floats, _PAIRS)
_define(operator.truediv, lambda b, x, y: b.fdiv(x, y, flags=FLAGS), floats, _PAIRS)
_define(operator.neg, lambda b, x: b.fneg(x, flags=FLAGS), floats, [(floats,)])
_define(operator.lt, lambda b, x, y: b.fcmp_ordered("<", x, y), mask, _PAIRS)
_define(operator.le, lambda b, x, y: b.fcmp_ordered("<=", x, y), mask, _PAIRS)
_define(operator.gt, lambda b, x, y: b.fcmp_ordered(">", x, y), mask, _PAIRS)
_define(operator.ge, lambda b, x, y: b.fcmp_ordered(">=", x, y), mask, _PAIRS)
_define(operator.eq, lambda b, x, y: b.fcmp_ordered("==", x, y), mask, _PAIRS)
_define(operator.and_, lambda b, x, y: b.and_(x, y), mask, [(mask, mask)])
_define(operator.or_, lambda b, x, y: b.or_(x, y), mask, [(mask, mask)])


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any, vector: ir.VectorType) -> Any:
    if array_type.dtype not in (types.float32, types.int32):  # its bytes would be taken for other numbers
        raise TypingError(f"a vector must lie in an array of float32 or int32, got {array_type.dtype}: convert it")
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


@intrinsic
def load(typingctx, array, index):
    """Floats from array[index : index + 16] of a flat float32 array."""

    def codegen(context, builder, sig, args):
        return builder.load(_pointer(context, builder, sig.args[0], args[0], args[1], _VEC), align=4)

    return floats(array, types.int64), codegen


@intrinsic
def store(typingctx, array, index, value):
    """array[index : index + 16] = value."""

    def codegen(context, builder, sig, args):
        builder.store(args[2], _pointer(context, builder, sig.args[0], args[0], args[1], _VEC), align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, floats), codegen


@inline
def copy(source, at, target, target_at, n):
    """Copy n scalars between flat arrays; a slice assignment compiles numba's error messages too."""
    for i in range(n):
        target[target_at + i] = source[at + i]


@intrinsic
def stream(typingctx, array, index, value):
    """Like `store`, but past the caches, for a whole cache line that is read much later; its address is aligned.

    An ordinary store to a line that is not cached reads it first (measured: such stores took half of the backward
    compositing). The lock that ends a job makes the lines visible to other threads.
    """

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], _VEC)
        instruction = builder.store(args[2], pointer, align=4 * LANES)
        instruction.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(_I32, 1)]))
        return context.get_dummy_value()

    return types.void(array, types.int64, floats), codegen


@intrinsic
def above(typingctx, array, index, value):
    """Mask of array[index : index + 16] > value, for a flat int32 array and an integer."""

    def codegen(context, builder, sig, args):
        lanes = builder.load(_pointer(context, builder, sig.args[0], args[0], args[1], _INTS), align=4)
        return builder.icmp_signed(">", lanes, _spread(builder, builder.trunc(args[2], _I32)))

    return mask(array, types.int64, types.int64), codegen


@intrinsic
def prefetch(typingctx, array, index):
    """Ask for the cache line of array[index] ahead of its use."""

    def codegen(context, builder, sig, args):
        pointer = builder.bitcast(
            _pointer(context, builder, sig.args[0], args[0], args[1], _VEC), ir.IntType(8).as_pointer()
        )
        ints = [ir.Constant(_I32, value) for value in (0, 3, 1)]  # read, keep in all levels, data
        name = "llvm.prefetch.p0" if "opaque" in str(type(pointer.type)).lower() else "llvm.prefetch.p0i8"
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, _I32, _I32, _I32])
        builder.call(builder.module.globals.get(name) or ir.Function(builder.module, kind, name), [pointer, *ints])
        return context.get_dummy_value()

    return types.void(array, types.int64), codegen


@intrinsic
def splat(typingctx, value):
    """A float32 in all lanes."""
    return floats(types.float32), lambda context, builder, sig, args: _spread(builder, args[0])


def constant(values: list[float]) -> Any:
    """A function without arguments that gives the sixteen values."""

    @intrinsic
    def get(typingctx):
        return floats(), lambda context, builder, sig, args: ir.Constant(_VEC, [float(v) for v in values])

    return get


@intrinsic
def select(typingctx, condition, yes, no):
    """Lane by lane: yes where the condition holds, else no."""

    def codegen(context, builder, sig, args):
        return builder.select(args[0], _spread(builder, args[1]), _spread(builder, args[2]))

    return floats(mask, yes, no), codegen


def _extremum(comparison: str) -> Any:
    @intrinsic
    def function(typingctx, a, b):
        def codegen(context, builder, sig, args):
            x, y = (_spread(builder, value) for value in args)
            return builder.select(builder.fcmp_ordered(comparison, x, y), x, y)

        return floats(a, b), codegen

    return function


minimum, maximum = _extremum("<"), _extremum(">")


def _unary(name: str) -> Any:
    @intrinsic
    def function(typingctx, x):
        def codegen(context, builder, sig, args):
            kind = ir.FunctionType(_VEC, [_VEC])
            full = f"llvm.{name}.v16f32"
            return builder.call(builder.module.globals.get(full) or ir.Function(builder.module, kind, full), args)

        return floats(floats), codegen

    return function


sqrt, ceil, floor = _unary("sqrt"), _unary("ceil"), _unary("floor")


@intrinsic
def bits(typingctx, condition):
    """The mask as an integer, lane i in bit i."""

    def codegen(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), _I64)

    return types.int64(mask), codegen


@intrinsic
def lowest_bit(typingctx, value):
    """Index of the lowest bit that is set, of an integer that is not zero."""
    return types.int64(types.int64), lambda context, builder, sig, args: builder.cttz(args[0], ir.Constant(_I1, 1))


@intrinsic
def negative_abs(typingctx, value):
    """-|value|."""

    def codegen(context, builder, sig, args):
        sign = ir.Constant(_INTS, [0x80000000] * LANES)
        return builder.bitcast(builder.or_(builder.bitcast(args[0], _INTS), sign), _VEC)

    return floats(floats), codegen


@intrinsic
def shift_exponent(typingctx, value, exponent):
    """Value * 2^exponent for whole exponents; neither value nor result may be subnormal."""

    def codegen(context, builder, sig, args):
        steps = builder.shl(builder.fptosi(args[1], _INTS), ir.Constant(_INTS, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(args[0], _INTS), steps), _VEC)

    return floats(floats, floats), codegen


@intrinsic
def exponent(typingctx, value):
    """floor(log2 value) of normal positive numbers."""

    def codegen(context, builder, sig, args):
        biased = builder.lshr(builder.bitcast(args[0], _INTS), ir.Constant(_INTS, [23] * LANES))
        return builder.sitofp(builder.sub(biased, ir.Constant(_INTS, [127] * LANES)), _VEC)

    return floats(floats), codegen


def _shift(lanes: list[int]) -> Any:
    @intrinsic
    def function(typingctx, value):
        def codegen(context, builder, sig, args):
            return builder.shuffle_vector(args[0], ir.Constant(_VEC, [0.0] * LANES), ir.Constant(_INTS, lanes))

        return floats(floats), codegen

    return function


# what the lane to the left, or to the right, holds; the outermost lane gets zero
from_left, from_right = _shift([LANES, *range(LANES - 1)]), _shift([*range(1, LANES), LANES])


@intrinsic
def pair_sums(typingctx, a, b):
    """Sums of neighbouring lanes: a's eight, then b's eight. Four levels of it reduce sixteen vectors to their sums."""

    def codegen(context, builder, sig, args):
        even, odd = (ir.Constant(_INTS, list(range(start, 2 * LANES, 2))) for start in (0, 1))
        return builder.fadd(builder.shuffle_vector(*args, even), builder.shuffle_vector(*args, odd))

    return floats(floats, floats), codegen
