"""Owen-scrambled Sobol points as a Mitsuba sampler: any part of any pixel's own endless sequence can be drawn.

Every prefix of a sequence is stratified about as well as a grid of its length would be, so that nothing is lost when
samples are added in rounds, and pixels of one wavefront may be at different places of theirs. Mitsuba's own samplers
stratify one block of a fixed size, which is built into their kernels.

References: Sobol points with the direction numbers of Joe and Kuo (2008); nested uniform scrambling of Owen (1995) by
the hash of Laine and Karras (2011), constants of Vegdahl (2021); shuffled sets of four dimensions of Burley (2020).
"""

from __future__ import annotations

from functools import cache
from typing import Any

BITS = 24  # of an index that the third and fourth dimension see: a float has no more, so the points end there anyway


def direction_numbers(degree: int, inner: int, first: tuple[int, ...]) -> list[int]:
    """Columns of the generator matrix of one dimension, digit k (from the binary point) in bit k.

    Args:
        degree: Of the primitive polynomial.
        inner: Its inner coefficients, as bits.
        first: The initial direction numbers m_1 .. m_degree.
    """
    m = list(first)
    for k in range(degree, BITS):
        number = m[k - degree] ^ (m[k - degree] << degree)
        for j in range(1, degree):
            number ^= (inner >> (degree - 1 - j) & 1) * (m[k - j] << j)
        m.append(number)
    return [sum((m[k] >> (k - digit) & 1) << digit for digit in range(k + 1)) for k in range(BITS)]


LENS = 1 << 30  # index of the lens draw; no path draws as often

THIRD, FOURTH = direction_numbers(2, 1, (1, 3)), direction_numbers(3, 1, (1, 3, 1))


@cache
def sampler_class(mi: Any, variant: str) -> Any:
    """`Sobol`, a Mitsuba sampler for this variant, which must be the active one and have wavefronts.

    Made for the lanes of a wavefront, each with its pixel, a seed, and the index of a point in the sequence that the
    pixel has under this seed (all of 32 bits). Of the dimensions drawn, the two of the film and the two of the first
    light are one set of four; so are, from then on, each new direction and the light sampled where it leads, in the
    order in which Mitsuba's path tracer asks for them. All other sets are shuffled against each other.
    """
    import drjit as dr

    u32 = mi.UInt32
    assert mi.variant() == variant, f"the active variant is {mi.variant()}, not {variant}"

    def mixed(x: Any) -> Any:
        """A hash of 32 bits with the constants of Wellons' `lowbias32`."""
        x = (x ^ (x >> 16)) * u32(0x7FEB352D)
        x = (x ^ (x >> 15)) * u32(0x846CA68B)
        return x ^ (x >> 16)

    def scrambled(digits: Any, seed: Any) -> Any:
        """Each digit flipped or not, as a hash of those before it says; the first digit is the lowest bit."""
        x = digits ^ digits * u32(0x3D20ADEA)
        x = (x + seed) * (seed >> 16 | 1)
        x ^= x * u32(0x05526C56)
        return x ^ x * u32(0x53A22864)

    def shuffled(index: Any, seed: Any) -> Any:
        """An order of the indices in which the first 2^k of them still make a net, for every k."""
        return dr.brev(scrambled(dr.brev(index), seed))

    def second(index: Any) -> Any:
        """The second dimension: Pascal's triangle modulo 2 times the digits of the index."""
        for mask, by in ((0xFFFF0000, 16), (0xFF00FF00, 8), (0xF0F0F0F0, 4), (0xCCCCCCCC, 2), (0xAAAAAAAA, 1)):
            index = index ^ (index & u32(mask)) >> by
        return index

    def product(columns: list[int], index: Any) -> Any:
        """A generator matrix times the digits of the index."""
        found = u32(0)
        for k, column in enumerate(columns):
            found ^= u32(column) & (u32(0) - (index >> k & 1))
        return found

    def unit(digits: Any) -> Any:
        """In [0, 1): a float keeps 24 of the digits."""
        return mi.Float(dr.brev(digits) >> 8) * 2.0**-24

    class Sobol(mi.Sampler):
        def __init__(self, pixel: Any, index: Any, seed: Any) -> None:
            super().__init__(mi.Properties())
            self.key = mixed(mixed(pixel) + seed)
            self.index, self.drawn = index, u32(0)

        def next_2d(self, active: Any = True) -> Any:
            number, self.drawn = self.drawn, self.drawn + 1
            later = (number & 3) == 1  # the second half of the set that began with the film or with a direction
            begun = dr.select(later, dr.select(number == 1, 0, number - 2), number)
            index, seed = shuffled(self.index, self._seed(begun)), mixed(self._seed(number) + 1)
            x = dr.select(later, product(THIRD, index), index)
            y = dr.select(later, product(FOURTH, index), second(index))
            return mi.Point2f(unit(scrambled(x, seed)), unit(scrambled(y, mixed(seed + 1))))

        def next_1d(self, active: Any = True) -> Any:
            seed, self.drawn = self._seed(self.drawn), self.drawn + 1
            return unit(scrambled(shuffled(self.index, seed), mixed(seed)))

        def next_lens(self) -> Any:
            """A place on the lens, from a set of its own: the second half of the film's set serves the first light."""
            self.drawn = u32(LENS)
            return self.next_2d()

        def begin_path(self) -> None:
            """End the camera's dimensions: the next ones belong to the first surface."""
            self.drawn = u32(1)

        def _seed(self, number: Any) -> Any:
            return mixed(self.key ^ mixed(number + u32(0x9E3779B9)))

    return Sobol
