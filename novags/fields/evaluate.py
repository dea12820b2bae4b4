"""A field at points: the outputs of its kernels, and the gradients of its tensors."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from novags.fields.cpu import encode, heads
from novags.fields.field import Field
from novags.fields.layout import ENCODED, HIDDEN, LANES, SEEDED, SIDE
from novags.splats.cpu.memory import empty
from novags.splats.cpu.parallel import run

GRAIN = 2048  # samples: of a range of work, and of a partial sum of the weights' gradient


def evaluate(field: Field, positions: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The raw outputs of a field, and the encoding, which their gradient needs again.

    Args:
        field: The field.
        positions: In the unit cube, float32 [S, 3]; points outside are extrapolated from the cell at the border.
        basis: 1, x, y, z of the directions, float32 [R, 4]; of every ray there are S / R samples in a row.

    Returns:
        raw [S, K] and encoded [S, 32], float32.
    """
    n, layout = len(positions), field.layout
    samples = max(1, n // max(1, len(basis)))
    encoded = empty((n, ENCODED))
    raw = empty((n, layout.outputs))
    run(
        encode.forward, n, GRAIN, positions, field.table.numpy().reshape(-1), layout.resolutions, layout.starts, encoded
    )
    w1, b1, w2, b2 = (getattr(field, name).numpy().reshape(-1) for name in ("w1", "b1", "w2", "b2"))
    run(heads.forward, n, GRAIN, encoded.reshape(-1), basis, samples, w1, b1, w2, b2, layout.static, layout.viewed, raw)
    run(encode.add_seeded, n, GRAIN, positions, field.seeded.numpy(), SIDE, np.float32(SEEDED), raw)
    return raw, encoded


def gradients(
    field: Field, positions: np.ndarray, basis: np.ndarray, encoded: np.ndarray, v_raw: np.ndarray
) -> dict[str, np.ndarray]:
    """Gradients of the field's tensors, by name and of their shapes.

    Args:
        field: The field.
        positions: As for `evaluate`.
        basis: As for `evaluate`.
        encoded: The result of `evaluate`.
        v_raw: Gradient of the raw outputs, float32 [S, K], C-contiguous.
    """
    n, layout = len(positions), field.layout
    samples, chunks = max(1, n // max(1, len(basis))), -(-n // GRAIN)
    v_encoded, partial = empty((n, ENCODED)), empty((chunks, heads.GRADIENT))
    w1, b1 = field.w1.numpy().reshape(-1), field.b1.numpy()
    w1t, w2t = (np.ascontiguousarray(w.numpy().T).reshape(-1) for w in (field.w1, field.w2))
    run(
        heads.backward, chunks, 1, GRAIN, encoded.reshape(-1), basis, samples, w1, b1, w1t, w2t, layout.static,
        layout.viewed, v_raw, v_encoded.reshape(-1), partial,
    )  # fmt: skip
    v_table = empty(field.table.numel())
    starts = layout.starts
    run(encode.backward, len(starts) - 1, 1, positions, v_encoded, layout.resolutions, starts, v_table)
    return {"table": v_table.reshape(-1, field.table.shape[1]), **_split(partial.sum(0))}


def _split(flat: np.ndarray) -> dict[str, Any]:
    shapes = {"w1": (ENCODED, HIDDEN), "b1": (HIDDEN,), "w2": (HIDDEN, LANES), "b2": (LANES,)}
    found, at = {}, 0
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        found[name] = flat[at : at + size].reshape(shape)
        at += size
    return found


def basis_of(directions: Tensor) -> np.ndarray:
    """1, x, y, z of unit directions [R, 3] as float32 [R, 4]."""
    return torch.cat([torch.ones_like(directions[:, :1]), directions], 1).float().contiguous().numpy()
