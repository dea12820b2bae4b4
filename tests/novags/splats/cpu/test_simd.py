"""Vectors of sixteen floats: every operation does in every lane what numpy does with the numbers."""

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from novags.splats.cpu.vectors import simd

RNG = np.random.default_rng(0)
X, Y = (RNG.uniform(-3, 3, 16).astype(np.float32) for _ in range(2))
Y[5] = X[5]
S = np.float32(0.75)
COUNTED = simd.constant([0.5 * k - 2 for k in range(16)])


@njit
def arithmetic(x, y, s, out):
    a, b = simd.load(x, 0), simd.load(y, 0)
    total = a
    total += b
    total -= s
    for k, value in enumerate((a + b, a - b, a * b, a / b, a + s, s - a, s * a, s / a, -a, total)):
        simd.store(out, 16 * k, value)


def test_arithmetic_is_that_of_every_lane_with_vectors_and_scalars_on_either_side() -> None:
    out = np.zeros(160, np.float32)
    arithmetic(X, Y, S, out)
    wanted = [X + Y, X - Y, X * Y, X / Y, X + S, S - X, S * X, S / X, -X, X + Y - S]
    np.testing.assert_allclose(out.reshape(10, 16), wanted, rtol=1e-5)


@njit
def comparisons(x, y, s, whole, out):
    a, b = simd.load(x, 0), simd.load(y, 0)
    found = (
        simd.bits(a < b), simd.bits(a <= b), simd.bits(a > b), simd.bits(a >= b), simd.bits(a == b), simd.bits(a < s),
        simd.bits(s < a), simd.bits((a < s) & (b < s)), simd.bits((a < s) | (b < s)),
        simd.bits(simd.above(whole, 0, 2)),
    )  # fmt: skip
    for k in range(10):
        out[k] = found[k]


def test_comparisons_set_the_bit_of_every_lane() -> None:
    whole, out = RNG.integers(-4, 5, 16).astype(np.int32), np.zeros(10, np.int64)
    comparisons(X, Y, S, whole, out)
    wanted = [X < Y, X <= Y, X > Y, X >= Y, X == Y, X < S, S < X, (X < S) & (Y < S), (X < S) | (Y < S), whole > 2]
    assert [int(bits) for bits in out] == [int(np.dot(lanes, 1 << np.arange(16))) for lanes in wanted]


@njit
def functions(x, y, s, out):
    a, b = simd.load(x, 0), simd.load(y, 0)
    square = a * a
    values = (
        COUNTED(), simd.splat(s), simd.select(a < b, a, s), simd.select(a < b, s, b), simd.minimum(a, b),
        simd.minimum(a, s), simd.maximum(a, b), simd.maximum(s, b), simd.sqrt(square), simd.ceil(a), simd.floor(a),
        simd.negative_abs(a), simd.exponent(square), simd.shift_exponent(a, simd.floor(b)), simd.pair_sums(a, b),
    )  # fmt: skip
    for k, value in enumerate(values):
        simd.store(out, 16 * k, value)


def test_functions_are_those_of_every_lane() -> None:
    out = np.zeros(240, np.float32)
    functions(X, Y, S, out)
    wanted = [
        np.arange(16) * 0.5 - 2, np.full(16, S), np.where(X < Y, X, S), np.where(X < Y, S, Y), np.minimum(X, Y),
        np.minimum(X, S), np.maximum(X, Y), np.maximum(S, Y), np.abs(X), np.ceil(X), np.floor(X), -np.abs(X),
        np.floor(np.log2(X * X)), X * 2.0 ** np.floor(Y), np.concatenate([X, Y]).reshape(16, 2).sum(1),
    ]  # fmt: skip
    np.testing.assert_allclose(out.reshape(15, 16), wanted, rtol=1e-5)


@njit
def moved(x, target):
    simd.copy(x, 3, target, 20, 5)
    return simd.lowest_bit(40)


def test_scalars_are_copied_to_another_place_and_the_lowest_bit_is_found() -> None:
    target = np.zeros(30, np.float32)
    assert moved(X, target) == 3
    np.testing.assert_array_equal(target[20:25], X[3:8])
    assert not target[:20].any()
    assert not target[25:].any()


def test_numbers_of_another_type_are_no_vectors() -> None:
    with pytest.raises(TypingError, match="float32 or int32, got float64"):
        arithmetic(X.astype(np.float64), Y, S, np.zeros(160, np.float32))
