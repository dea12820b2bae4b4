"""The Adam step."""

# mypy: allow-untyped-defs

import numpy as np

from .compiler import kernel

ONE = np.float32(1.0)


@kernel
def adam(begin, end, values, gradients, first, second, rates, beta1, beta2, correction1, correction2, eps):
    """One Adam step in place on rows begin..end-1 of values [N, P], one learning rate per column, rates [P]; float32.

    correction1 = 1 - beta1^t, correction2 = sqrt(1 - beta2^t). Same formula, and order, as torch.optim.Adam.
    """
    for i in range(begin, end):
        for j in range(len(rates)):
            g = gradients[i, j]
            m = first[i, j] + (g - first[i, j]) * (ONE - beta1)
            v = second[i, j] * beta2 + g * g * (ONE - beta2)
            first[i, j], second[i, j] = m, v
            values[i, j] -= rates[j] / correction1 * m / (np.sqrt(v) / correction2 + eps)
