"""Between rows in memory, one per Gaussian, and columns of sixteen Gaussians, one vector per component.

Scalar copies cost more than the arithmetic on the columns (measured: half of the projection's backward pass).
"""

# mypy: allow-untyped-defs

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler import inline
from .simd import _I64, _INTS, _VEC, LANES, _pointer, load, store


def _read(context: Any, builder: Any, array_type: Any, array: Any, at: Any, n: int) -> list[Any]:
    """The vectors at array[at : at + 16 n]."""
    places = [builder.add(at, ir.Constant(_I64, LANES * j)) for j in range(n)]
    return [builder.load(_pointer(context, builder, array_type, array, p, _VEC), align=4) for p in places]


def _write(context: Any, builder: Any, array_type: Any, array: Any, at: Any, vectors: list[Any]) -> None:
    for j, vector in enumerate(vectors):
        place = builder.add(at, ir.Constant(_I64, LANES * j))
        builder.store(vector, _pointer(context, builder, array_type, array, place, _VEC), align=4)


def _pick(builder: Any, vectors: list[Any], sources: list[tuple[int, int]]) -> Any:
    """The vector whose lane i is lane sources[i][1] of vectors[sources[i][0]]."""
    found = vectors[0]
    for j in range(1, len(vectors)):
        lanes = [LANES + lane if vector == j else (lane if j == 1 else i) for i, (vector, lane) in enumerate(sources)]
        found = builder.shuffle_vector(found, vectors[j], ir.Constant(_INTS, lanes))
    return found


def _to_columns(width: int) -> Any:
    @intrinsic
    def function(typingctx, rows, at, columns, column):
        """Sixteen rows of `width` floats from rows[at] on become vectors from columns[16 column] on; flat arrays."""

        def codegen(context, builder, sig, args):
            vectors = _read(context, builder, sig.args[0], args[0], args[1], width)
            places = [[divmod(width * lane + c, LANES) for lane in range(LANES)] for c in range(width)]
            start = builder.mul(args[3], ir.Constant(_I64, LANES))
            picked = [_pick(builder, vectors, sources) for sources in places]
            _write(context, builder, sig.args[2], args[2], start, picked)
            return context.get_dummy_value()

        return types.void(rows, types.int64, columns, types.int64), codegen

    return function


def _from_columns(width: int) -> Any:
    @intrinsic
    def function(typingctx, columns, column, rows, at):
        """The reverse of `to_columns`."""

        def codegen(context, builder, sig, args):
            start = builder.mul(args[1], ir.Constant(_I64, LANES))
            vectors = _read(context, builder, sig.args[0], args[0], start, width)
            places = [[divmod(LANES * o + lane, width)[::-1] for lane in range(LANES)] for o in range(width)]
            picked = [_pick(builder, vectors, sources) for sources in places]
            _write(context, builder, sig.args[2], args[2], args[3], picked)
            return context.get_dummy_value()

        return types.void(columns, types.int64, rows, types.int64), codegen

    return function


to_columns3, to_columns4 = _to_columns(3), _to_columns(4)
from_columns3, from_columns4 = _from_columns(3), _from_columns(4)


@intrinsic
def transpose(typingctx, source, at, stride, target, target_at, target_stride):
    """Sixteen rows of sixteen floats, `stride` apart, become columns `target_stride` apart; flat float32 arrays."""

    def codegen(context, builder, sig, args):
        index = ir.IntType(64)
        rows = []
        for i in range(LANES):
            place = builder.add(args[1], builder.mul(args[2], ir.Constant(index, i)))
            rows.append(builder.load(_pointer(context, builder, sig.args[0], args[0], place, _VEC), align=4))
        for step in (1, 2, 4, 8):  # exchange the off-diagonal halves of ever larger squares
            low = [lane if not lane & step else LANES + lane - step for lane in range(LANES)]
            high = [lane + step if not lane & step else LANES + lane for lane in range(LANES)]
            for i in (i for i in range(LANES) if not i & step):
                pair = rows[i], rows[i + step]
                rows[i] = builder.shuffle_vector(*pair, ir.Constant(_INTS, low))
                rows[i + step] = builder.shuffle_vector(*pair, ir.Constant(_INTS, high))
        for i in range(LANES):
            place = builder.add(args[4], builder.mul(args[5], ir.Constant(index, i)))
            builder.store(rows[i], _pointer(context, builder, sig.args[3], args[3], place, _VEC), align=4)
        return context.get_dummy_value()

    integers = (types.int64, types.int64)
    return types.void(source, *integers, target, *integers), codegen


@inline
def gather3(rows, first, count, columns, column):
    """`count` rows of rows [N, 3] to three columns; lanes from `count` on keep their values."""
    if count == LANES:
        to_columns3(rows.reshape(-1), 3 * first, columns, column)
        return
    for lane in range(count):
        for j in range(3):
            columns[(column + j) * LANES + lane] = rows[first + lane, j]


@inline
def add3(columns, column, first, count, rows):
    """Add three columns to `count` rows of rows [N, 3]; may overwrite the columns."""
    if count < LANES:
        for lane in range(count):
            for j in range(3):
                rows[first + lane, j] += columns[(column + j) * LANES + lane]
        return
    flat = rows.reshape(-1)
    from_columns3(columns, column, columns, column * LANES)
    for j in range(3):
        at = 3 * first + j * LANES
        store(flat, at, load(flat, at) + load(columns, (column + j) * LANES))
