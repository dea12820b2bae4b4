"""The Adam step, alone and together with the gradient of the harmonics. Formula and order as in torch.optim.Adam."""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..raster import harmonics
from ..vectors.simd import LANES
from ..vectors.transpose import add3, gather3

ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
# Of gradients, scales and coefficients: none that is smaller makes the gradient of another parameter overflow
LARGE = np.float32(1e12)


@inline
def _step(i, value, gradient, first, second, rate, numbers):
    beta1, beta2, correction1, correction2, eps = numbers
    g = gradient[i]
    m = first[i] + (g - first[i]) * (ONE - beta1)
    v = second[i] * beta2 + g * g * (ONE - beta2)
    first[i], second[i] = m, v
    value[i] -= rate / correction1 * m / (np.sqrt(v) / correction2 + eps)


@kernel
def adam(begin, end, values, gradients, first, second, rate, beta1, beta2, correction1, correction2, eps):
    """One step in place on values begin..end-1 of flat float32 arrays.

    correction1 = 1 - beta1^t, correction2 = sqrt(1 - beta2^t).
    """
    numbers = beta1, beta2, correction1, correction2, eps
    v, g, m, s = values[begin:end], gradients[begin:end], first[begin:end], second[begin:end]
    for i in range(len(v)):
        _step(i, v, g, m, s, rate, numbers)


@kernel
def adam_columns(begin, end, values, gradients, first, second, rates, beta1, beta2, correction1, correction2, eps):
    """One step in place on rows begin..end-1 of [N, P] arrays, on as many columns as there are rates."""
    numbers = beta1, beta2, correction1, correction2, eps
    for row in range(begin, end):
        _row_step(values[row], gradients[row], first[row], second[row], rates, numbers)


@inline
def _row_step(value, gradient, first, second, rates, numbers):
    for i in range(len(rates)):
        _step(i, value, gradient, first, second, rates[i], numbers)


@kernel
def find_large(begin, end, values, found):
    """Sets found[0] if one of the flat values begin..end-1 is LARGE, or not a number."""
    count = 0
    for i in range(begin, end):
        count += not abs(values[i]) < LARGE
    if count:
        found[0] = 1


@inline
def _pull(weight, coefficients, gradient):
    """Add the slope of weight * c^2, of every coefficient c but the base colour; returns the sum of these terms."""
    total = 0.0
    for j in range(3, len(coefficients)):
        gradient[j] += TWO * weight * coefficients[j]
        total += weight * coefficients[j] * coefficients[j]
    return total


@kernel
def adam_harmonics(
    begin, end, block_size, degree, means, sh, first, second, center, v_colors, v_means, v_center, pull, penalties,
    rates, beta1, beta2, correction1, correction2, eps,
):  # fmt: skip
    """`harmonics.backward` and `adam_columns` for blocks begin..end-1, without writing the gradient to memory.

    sh and its moments [N, 3 K] change in place, and the gradient is added to v_means [N, 3]. Unless v_center is empty,
    writes its partial sums [blocks, 3] of the gradient of the camera centre. Unless pull [N] is empty, the loss has the
    further term sum of pull_i |c_i|^2 over all coefficients but the base colour; penalties [blocks] float64 are its
    partial sums.
    """
    n, n_coefficients, numbers = len(means), (degree + 1) * (degree + 1), (beta1, beta2, correction1, correction2, eps)
    points, basis = np.ones(3 * LANES, np.float32), np.empty(16 * LANES, np.float32)
    v_basis, coefficients = np.empty(16 * LANES, np.float32), np.zeros(48 * LANES, np.float32)
    v_color, v_points = np.zeros(3 * LANES, np.float32), np.empty(3 * LANES, np.float32)
    gradient, total = np.empty((LANES, sh.shape[1]), np.float32), np.empty(3, np.float32)
    for block in range(begin, end):
        total[:], penalty = ZERO, 0.0
        for start in range(block * block_size, min(n, (block + 1) * block_size), LANES):
            count = min(LANES, n - start)
            v_color[:] = ZERO
            gather3(v_colors, start, count, v_color, 0)
            if harmonics._any(v_color):
                harmonics._gather(means, center, sh, start, count, n_coefficients, points, coefficients)
                harmonics._backward(degree, n_coefficients, points, basis, v_basis, coefficients, v_color, v_points)
                harmonics._scatter(coefficients, 0, count, 3 * n_coefficients, gradient)
                for j in range(3):
                    for lane in range(count):
                        total[j] -= v_points[j * LANES + lane]
                add3(v_points, 0, start, count, v_means)
            else:
                gradient[:] = ZERO
            for lane in range(count):
                i = start + lane
                if len(pull) and pull[i] != ZERO:
                    penalty += _pull(pull[i], sh[i], gradient[lane])
                _row_step(sh[i], gradient[lane], first[i], second[i], rates, numbers)
        if len(v_center):
            v_center[block] = total
        if len(pull):
            penalties[block] = penalty
