"""The Adam step. Same formula, and order of operations, as torch.optim.Adam."""

# mypy: allow-untyped-defs

import numpy as np

from .compiler import inline, kernel

ONE = np.float32(1.0)


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
        v, g, m, s = values[row], gradients[row], first[row], second[row]
        for i in range(len(rates)):
            _step(i, v, g, m, s, rates[i], numbers)
