"""What a radiance field consists of: tables of features on grids of eight resolutions, and one small network.

    encoded  [S, 32]   eight levels of four features, each interpolated between the eight corners of its cell
    hidden   [S, 32]   relu(encoded W1 + b1)
    lanes    [S, 16]   hidden W2 + b2: the density, `static` outputs, and four coefficients of every `viewed` output
    raw      [S, K]    K = 1 + static + viewed: lanes, those that depend on the view summed over (1, x, y, z) of its
                       direction, which are harmonics of degree 0 and 1 up to factors

Levels whose grid has more corners than a table has rows share rows by a hash (Mueller et al. 2022, section 3). Source
of the encoding: "Instant neural graphics primitives with a multiresolution hash encoding"; the network is smaller.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

LEVELS, FEATURES, HIDDEN, LANES = 8, 4, 32, 16
ENCODED = LEVELS * FEATURES
BASIS = 4  # of a direction: 1, x, y, z
DENSITY_MAX = 15.0  # of the logarithm of a density: e^15 is opaque within 1e-6 of the box, and its gradient finite
FIRST_DENSITY = -4.0  # its logarithm at the start: a fog that every ray still gets through
SIDE = 96  # cells along an axis of the map of the first points, and of the one that rays are sampled after
SEEDED = 6.0  # added to the logarithm of the density in cells near first points


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Sizes of a field.

    Attributes:
        coarsest: Cells along an axis of the first level.
        finest: Of the last one; the levels between them grow by one factor.
        log2_rows: Logarithm of the most rows that a level's table has.
        static: Outputs that do not depend on the direction.
        viewed: Outputs that do.
    """

    coarsest: int = 16
    finest: int = 512
    log2_rows: int = 17
    static: int = 0
    viewed: int = 3

    def __post_init__(self) -> None:
        if not 2 <= self.coarsest <= self.finest <= 4096:
            raise ValueError(f"coarsest and finest must be 2 <= coarsest <= finest <= 4096 cells, got {self.coarsest} "
                             f"and {self.finest}")  # fmt: skip
        if not 8 <= self.log2_rows <= 22:
            raise ValueError(f"log2_rows must lie in 8..22, got {self.log2_rows}")
        lanes = 1 + self.static + BASIS * self.viewed
        if self.static < 0 or self.viewed < 0 or lanes > LANES:
            raise ValueError(f"a field has room for {LANES - 1} lanes beside the density, a viewed output taking "
                             f"{BASIS}, got {self.static} static and {self.viewed} viewed outputs")  # fmt: skip

    @property
    def outputs(self) -> int:
        """K, the columns of `raw`."""
        return 1 + self.static + self.viewed

    @property
    def resolutions(self) -> np.ndarray:
        """Cells along an axis of every level, int64 [8]."""
        factor = (self.finest / self.coarsest) ** (1 / (LEVELS - 1))
        return np.array([int(self.coarsest * factor**level + 1e-6) for level in range(LEVELS)], np.int64)

    @property
    def rows(self) -> np.ndarray:
        """Rows of every level's table, int64 [8]; (resolution + 1)^3 where they fit."""
        return np.minimum((self.resolutions + 1) ** 3, 1 << self.log2_rows)

    @property
    def starts(self) -> np.ndarray:
        """Where every level's rows begin in the table of all, and where the last ends, int64 [9]."""
        return np.concatenate([[0], np.cumsum(self.rows)])


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

    layout: Layout
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


def first_field(layout: Layout, seed: int, seeded: np.ndarray | None = None) -> Field:
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
