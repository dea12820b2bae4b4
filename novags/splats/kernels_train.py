"""CPU kernels of the training loop: the optimiser."""
# mypy: allow-untyped-defs
# numba infers the types of kernels; shapes are in the docstrings

import numpy as np
from numba import njit, prange

ONE = np.float32(1.0)
FAST = {"contract", "nsz"}


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def adam(values, gradients, first, second, rates, beta1, beta2, correction1, correction2, eps):
    """One Adam step in place on values [N, P] with one learning rate per column, rates [P]; all float32.

    correction1 = 1 - beta1^t, correction2 = sqrt(1 - beta2^t). Same formula, and order, as torch.optim.Adam.
    """
    for i in prange(len(values)):
        for j in range(len(rates)):
            g = gradients[i, j]
            m = first[i, j] + (g - first[i, j]) * (ONE - beta1)
            v = second[i, j] * beta2 + g * g * (ONE - beta2)
            first[i, j], second[i, j] = m, v
            values[i, j] -= rates[j] / correction1 * m / (np.sqrt(v) / correction2 + eps)
