"""The field in plain torch, for tests and for reading: values and, by autograd, gradients, for comparison with the
kernels.

Any float dtype; slow. Arguments as for `evaluate`.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from novags.fields.layout import BASIS, SEEDED, SIDE, FieldLayout

PRIMES = (1, 2654435761, 805459861)


def evaluate_reference(
    layout: FieldLayout, tensors: Mapping[str, Tensor], seeded: Tensor, positions: Tensor, basis: Tensor
) -> Tensor:
    """Raw outputs [S, K] at positions [S, 3] of the unit cube.

    Args:
        layout: Sizes.
        tensors: table, w1, b1, w2, b2 as in `Field`.
        seeded: As in `Field`.
        positions: In the unit cube.
        basis: 1, x, y, z of the rays' directions [R, 4].
    """
    hidden = torch.relu(encode_reference(layout, tensors["table"], positions) @ tensors["w1"] + tensors["b1"])
    lanes = hidden @ tensors["w2"] + tensors["b2"]
    split = 1 + layout.static
    viewed = lanes[:, split : split + BASIS * layout.viewed].reshape(len(lanes), layout.viewed, BASIS)
    directions = basis.repeat_interleave(len(positions) // len(basis), 0)
    cell = (positions * SIDE).long().clamp(0, SIDE - 1)
    more = SEEDED * seeded[(cell[:, 2] * SIDE + cell[:, 1]) * SIDE + cell[:, 0]]
    fixed = torch.cat([lanes[:, :1] + more.to(lanes)[:, None], lanes[:, 1:split]], 1)
    return torch.cat([fixed, (viewed * directions[:, None]).sum(-1)], 1)


def encode_reference(layout: FieldLayout, table: Tensor, positions: Tensor) -> Tensor:
    """Interpolated features of all levels [S, 32]."""
    parts = []
    for level, resolution in enumerate(layout.resolutions.tolist()):
        start, rows = int(layout.starts[level]), int(layout.rows[level])
        scaled = positions * resolution
        low = scaled.long().clamp(0, resolution - 1)
        beyond, total = scaled - low, torch.zeros(len(positions), table.shape[1], dtype=table.dtype)
        for corner in range(8):
            step = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2])
            weight = torch.where(step.bool(), beyond, 1 - beyond).prod(1, keepdim=True)
            total = total + weight * table[start + _rows_of(low + step, resolution, rows)]
        parts.append(total)
    return torch.cat(parts, 1)


def _rows_of(corners: Tensor, resolution: int, rows: int) -> Tensor:
    side = resolution + 1
    if side**3 <= rows:
        return (corners[:, 2] * side + corners[:, 1]) * side + corners[:, 0]
    mixed = torch.zeros(len(corners), dtype=torch.int64)
    for axis, prime in enumerate(PRIMES):
        mixed ^= corners[:, axis] * prime & 0xFFFFFFFF
    return mixed & (rows - 1)
