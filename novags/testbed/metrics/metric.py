"""A score of a picture against its reference, as a row of `METRICS`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from novags.testbed.metrics.picture import Image


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One row of `METRICS`.

    Attributes:
        heading: In tables.
        score: (image, reference) -> a number. Both are [h,w,3], sRGB code in 0..1; `aligned` says what was done before.
            Raises ValueError for pictures that it cannot compare.
        more: Whether more is better.
        unit: Of the number; "" for none.
        digits: After the point, in tables.
        aligned: What brings the image to the tone of the reference first: per channel a gain and an offset ("affine")
            or a monotone curve ("tone"). Only channels of the reference with contrast take part then.
        in_studies: Whether pages on studies show it, against the well-lit pictures.
        squared: Whether it is a PSNR: the known variance of a rendered truth is subtracted from its squared error.
            Other scores keep the bias that the truth's noise gives them; it is measured beside them.
        missing: (width, height) -> why it cannot be computed here, of pictures of that size if one is given; None if it
            can. For scores by networks, whose weights may not be there.
        protocol: The published data set whose protocol it belongs to: of other captures it is not computed; "" for all.
    """

    heading: str
    score: Callable[[Image, Image], float]
    more: bool
    unit: str = ""
    digits: int = 3
    aligned: Literal["none", "affine", "tone"] = "none"
    in_studies: bool = True
    squared: bool = False
    missing: Callable[..., str | None] | None = None
    protocol: str = ""
