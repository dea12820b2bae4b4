"""The parts of a radiance field: tables of features on grids of eight resolutions, and one small network.

    encoded  [S, 32]   eight levels of four features, each interpolated between the eight corners of its cell
    hidden   [S, 32]   relu(encoded W1 + b1)
    lanes    [S, 16]   hidden W2 + b2: the density, `static` outputs, and four coefficients of every `viewed` output
    raw      [S, K]    K = 1 + static + viewed: lanes; view-dependent ones are summed over (1, x, y, z) of its
                       direction, which are harmonics of degree 0 and 1 up to factors

Levels whose grid has more corners than a table has rows share rows by a hash (Mueller et al. 2022, section 3). Source
of the encoding: "Instant neural graphics primitives with a multiresolution hash encoding"; the network is smaller.
"""

from dataclasses import dataclass

import numpy as np

LEVELS, FEATURES, HIDDEN, LANES = 8, 4, 32, 16
ENCODED = LEVELS * FEATURES
BASIS = 4  # of a direction: 1, x, y, z
DENSITY_MAX = 15.0  # of the logarithm of a density: e^15 is opaque within 1e-6 of the box, and its gradient finite
FIRST_DENSITY = -4.0  # its logarithm at the start: a fog that every ray still gets through
SIDE = 96  # cells along an axis of the map of the first points, and of the map that guides samples along rays
SEEDED = 6.0  # added to the logarithm of the density in cells near first points


@dataclass(frozen=True, kw_only=True)
class FieldLayout:
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
