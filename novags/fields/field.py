"""The trained tensors of a radiance field, and how they begin."""

import math
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from novags.fields.layout import ENCODED, FEATURES, FIRST_DENSITY, HIDDEN, LANES, SIDE, FieldLayout


@dataclass
class Field:
    """The trained tensors of a radiance field, float32.

    Attributes:
        layout: Its sizes.
        table: Features of all levels [rows, 4].
        w1: [32, 32], from encoded to hidden.
        b1: [32].
        w2: [32, 16], from hidden to lanes; columns beyond the outputs are not used.
        b2: [16].
        seeded: 1 in cells of the unit cube near first points, where the logarithm of the density is SEEDED larger than
            the network says, else 0: uint8 [96^3], z-major, not trained.
    """

    layout: FieldLayout
    table: Tensor
    w1: Tensor
    b1: Tensor
    w2: Tensor
    b2: Tensor
    seeded: Tensor

    def __post_init__(self) -> None:
        if self.seeded.dtype != torch.uint8 or self.seeded.shape != (SIDE**3,):
            raise ValueError(f"seeded of a field must be uint8 [{SIDE**3}], got {self.seeded.dtype} "
                             f"{list(self.seeded.shape)}")  # fmt: skip
        want = {"table": (int(self.layout.starts[-1]), FEATURES), "w1": (ENCODED, HIDDEN), "b1": (HIDDEN,),
                "w2": (HIDDEN, LANES), "b2": (LANES,)}  # fmt: skip
        for name, shape in want.items():
            tensor = getattr(self, name)
            if tensor.shape != shape:
                raise ValueError(f"{name} of a field must be {list(shape)}, got {list(tensor.shape)}")

    def tensors(self) -> dict[str, Tensor]:
        """The trained tensors by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("layout", "seeded")}


def first_field(layout: FieldLayout, seed: int, seeded: np.ndarray | None = None) -> Field:
    """A thin fog of one colour: features near zero, weights as He et al. (2015) for ReLU.

    Args:
        layout: Sizes.
        seed: Of the random numbers.
        seeded: Where the fog is thick, bool [96^3]; None: nowhere.
    """
    rng = np.random.default_rng([seed, 0xF1E1D])

    def uniform(shape: tuple[int, ...], reach: float) -> Tensor:
        return torch.from_numpy(rng.uniform(-reach, reach, shape).astype(np.float32))

    b2 = torch.zeros(LANES)
    b2[0] = FIRST_DENSITY
    return Field(
        layout,
        table=uniform((int(layout.starts[-1]), FEATURES), 1e-2),  # 0 would give all rows of a cell equal gradients
        w1=uniform((ENCODED, HIDDEN), math.sqrt(6 / ENCODED)),
        b1=torch.zeros(HIDDEN),
        w2=uniform((HIDDEN, LANES), math.sqrt(6 / HIDDEN)),
        b2=b2,
        seeded=torch.zeros(SIDE**3, dtype=torch.uint8) if seeded is None else torch.from_numpy(seeded.astype(np.uint8)),
    )
