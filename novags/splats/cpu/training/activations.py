"""Trained values to rendered ones: exp and sigmoid, with their sums for the regularisers, and back."""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..vectors.simd import LANES, copy, load, store
from ..vectors.vector_math import exp

ZERO, ONE = np.float32(0.0), np.float32(1.0)
BLOCK = 4096  # values per partial sum: fixed, so that it does not depend on the threads


@inline
def _activate(is_sigmoid, x):
    return ONE / (exp(-x) + ONE) if is_sigmoid else exp(x)


@kernel
def forward(begin, end, is_sigmoid, inputs, outputs, sums):
    """Outputs = exp(inputs), or sigmoid(inputs), for blocks begin..end-1 of flat arrays; sums [blocks] of outputs."""
    buffer = np.zeros(LANES, np.float32)
    for block in range(begin, end):
        stop = min(len(inputs), (block + 1) * BLOCK)
        total = 0.0
        for first in range(block * BLOCK, stop, LANES):
            if first + LANES <= stop:
                store(outputs, first, _activate(is_sigmoid, load(inputs, first)))
            else:
                copy(inputs, first, buffer, 0, stop - first)
                store(buffer, 0, _activate(is_sigmoid, load(buffer, 0)))
                copy(buffer, 0, outputs, first, stop - first)
        for i in range(block * BLOCK, stop):
            total += outputs[i]
        sums[block] = total


@kernel
def backward(begin, end, is_sigmoid, outputs, v_outputs, v_mean, v_inputs):
    """Gradient of the inputs from the outputs' gradient and, times v_mean, of each output's share in their mean."""
    for block in range(begin, end):
        for i in range(block * BLOCK, min(len(outputs), (block + 1) * BLOCK)):
            slope = outputs[i] * (ONE - outputs[i]) if is_sigmoid else outputs[i]
            v_inputs[i] = slope * (v_outputs[i] + v_mean)
