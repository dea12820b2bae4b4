"""The small network behind the encoding, and its gradient: vectors of sixteen run over the units of a layer.

Weights come as flat arrays in the order in which the loops want them: `w1` [32 * 32] encoded-major, `w1t` hidden-major,
`w2` [32 * 16] hidden-major, `w2t` lane-major.
"""

# mypy: allow-untyped-defs

import numpy as np

from novags.splats.cpu.compiler import inline, kernel
from novags.splats.cpu.vectors.simd import load, maximum, select, splat, store

ZERO = np.float32(0.0)
ENCODED, HIDDEN, LANES, BASIS = 32, 32, 16, 4
GRADIENT = ENCODED * HIDDEN + HIDDEN + HIDDEN * LANES + LANES  # w1, b1, w2, b2 in a row


@inline
def _hidden(encoded, s, w1, b1, hidden):
    """Activations before the ReLU, into hidden [32]."""
    low, high = load(b1, 0), load(b1, 16)
    for e in range(ENCODED):
        x = splat(encoded[s * ENCODED + e])
        low = low + x * load(w1, e * HIDDEN)
        high = high + x * load(w1, e * HIDDEN + 16)
    store(hidden, 0, low)
    store(hidden, 16, high)


@kernel
def forward(begin, end, encoded, basis, samples, w1, b1, w2, b2, static, viewed, raw):
    """Raw [S, 1 + static + viewed] for the samples begin..end-1.

    encoded [S * 32]; basis [R, 4] of the rays' directions; samples: of a ray.
    """
    hidden, lanes = np.empty(HIDDEN, np.float32), np.empty(LANES, np.float32)
    for s in range(begin, end):
        _hidden(encoded, s, w1, b1, hidden)
        out = load(b2, 0)
        for h in range(HIDDEN):
            out = out + splat(max(hidden[h], ZERO)) * load(w2, h * LANES)
        store(lanes, 0, out)
        ray = s // samples
        for i in range(1 + static):
            raw[s, i] = lanes[i]
        for m in range(viewed):
            at = 1 + static + BASIS * m
            total = ZERO
            for b in range(BASIS):
                total += lanes[at + b] * basis[ray, b]
            raw[s, 1 + static + m] = total


@kernel
def backward(
    begin, end, chunk, encoded, basis, samples, w1, b1, w1t, w2t, static, viewed, v_raw, v_encoded, v_weights
):  # fmt: skip
    """Gradients of chunks begin..end-1 of `chunk` samples each, from v_raw [S, 1 + static + viewed].

    v_encoded [S * 32] is overwritten, and so is v_weights [chunks, GRADIENT], a row for every chunk: their sum in order
    does not depend on the threads.
    """
    hidden, v_hidden, lanes = np.empty(HIDDEN, np.float32), np.empty(HIDDEN, np.float32), np.zeros(LANES, np.float32)
    zero = splat(ZERO)
    n = len(v_raw)
    for c in range(begin, end):
        grad = v_weights[c]
        for i in range(GRADIENT):
            grad[i] = ZERO
        for s in range(c * chunk, min((c + 1) * chunk, n)):
            if not _lanes(v_raw, s, basis, samples, static, viewed, lanes):
                store(v_encoded, s * ENCODED, zero)
                store(v_encoded, s * ENCODED + 16, zero)
                continue
            _hidden(encoded, s, w1, b1, hidden)
            out, low, high = load(lanes, 0), zero, zero
            for lane in range(1 + static + BASIS * viewed):
                v = splat(lanes[lane])
                low = low + v * load(w2t, lane * HIDDEN)
                high = high + v * load(w2t, lane * HIDDEN + 16)
            before_low, before_high = load(hidden, 0), load(hidden, 16)
            low, high = select(before_low > zero, low, zero), select(before_high > zero, high, zero)
            store(v_hidden, 0, low)
            store(v_hidden, 16, high)
            store(hidden, 0, maximum(before_low, zero))
            store(hidden, 16, maximum(before_high, zero))
            _add(grad, ENCODED * HIDDEN, low)
            _add(grad, ENCODED * HIDDEN + 16, high)
            base = ENCODED * HIDDEN + HIDDEN
            for h in range(HIDDEN):
                if hidden[h] != ZERO:
                    _add(grad, base + h * LANES, splat(hidden[h]) * out)
            _add(grad, base + HIDDEN * LANES, out)
            first, second = zero, zero
            for h in range(HIDDEN):
                v = splat(v_hidden[h])
                first = first + v * load(w1t, h * ENCODED)
                second = second + v * load(w1t, h * ENCODED + 16)
            store(v_encoded, s * ENCODED, first)
            store(v_encoded, s * ENCODED + 16, second)
            for e in range(ENCODED):
                x = splat(encoded[s * ENCODED + e])
                _add(grad, e * HIDDEN, x * low)
                _add(grad, e * HIDDEN + 16, x * high)


@inline
def _add(array, at, value):
    store(array, at, load(array, at) + value)


@inline
def _lanes(v_raw, s, basis, samples, static, viewed, lanes):
    """Gradient of the lanes; whether there is any."""
    ray, found = s // samples, False
    for i in range(1 + static):
        lanes[i] = v_raw[s, i]
        found |= v_raw[s, i] != ZERO
    for m in range(viewed):
        v = v_raw[s, 1 + static + m]
        found |= v != ZERO
        for b in range(BASIS):
            lanes[1 + static + BASIS * m + b] = v * basis[ray, b]
    return found
