"""Variance stabilisation of Poisson-Gaussian data with known noise: the generalised Anscombe transform.

With y = s P + n, P Poisson of mean m, n normal of variance o, and everything divided by s (electrons):

    T(e) = 2 sqrt(e + 3/8 + o / s**2)        (Murtagh, Starck, Bijaoui 1995, "Image restoration with noise suppression")

has a variance near 1 for any m. Below e = 0 the transform continues as its tangent there. No datum is cut, so the
transform can be inverted everywhere; where read noise dominates, which is where data fall below zero, the tangent is as
good a stabiliser as the root. The variance tends to the read noise's variance over `o / s**2 + 3/8` as m goes to 0:
less than 1 where read noise is small, because no transform can stabilise a pixel that counts nothing.

`inverse` is the algebraic inverse: it turns T(m) back into m. An estimate that was trained to be T(m) itself needs this
inverse. An average of T(y) is another thing: E T(y) < T(m), by about 1/(4 sqrt(m)), and needs an unbiased inverse.
"""

from dataclasses import dataclass

from torch import Tensor

OFFSET = 3 / 8


@dataclass(frozen=True)
class Anscombe:
    """The transform of data in electrons with this read noise, values below in units of the noise.

    Attributes:
        read_variance: o / s**2, electrons**2; any shape that broadcasts with the data.
    """

    read_variance: Tensor

    def __call__(self, electrons: Tensor) -> Tensor:
        """Electrons to units of the noise: strictly increasing, 0 at black."""
        root = (self.read_variance + OFFSET).sqrt()
        # The clamp keeps the branch that is not taken away from roots of negative numbers, whose gradient is NaN.
        above = electrons.clamp_min(0)
        # The difference of the two roots, without its cancellation where read noise is large
        return 2 * above / ((above + self.read_variance + OFFSET).sqrt() + root) + electrons.clamp_max(0) / root

    def inverse(self, values: Tensor) -> Tensor:
        """Units of the noise to electrons; exact: `inverse(T(x)) = x`."""
        root = (self.read_variance + OFFSET).sqrt()
        above = values.clamp_min(0)
        # (v / 2 + r)**2 - r**2 without the cancellation of two large squares
        return above * (above / 4 + root) + values.clamp_max(0) * root
