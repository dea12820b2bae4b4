"""Where a field is: a box around the first points, all space beyond it contracted into a shell, and the reach of rays.

    x'  = (x - center) / half                        the box is |x'| <= 1 in the largest coordinate
    x'' = x' f(r) / r,  f(r) = 1 + c - c / (1 + (r - 1) / c)   where r = max |x'| > 1, c = 1/2
    u   = (x'' + 1 + c) / (2 + 2 c)                  the unit cube

after Barron et al. 2022 (mip-NeRF 360, equation 10), with the largest coordinate for the norm and half of their shell.
"""

from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

SHELL = 0.5  # c: thickness of the shell that holds everything beyond the box
OUTLIERS = 0.005  # share of the points beyond each side: a wrong point must not blow up the box
MARGIN = 1.1  # of the box around those points: surfaces go on between and behind points
THINNEST = 1 / 3  # of its longest side: points on a wall would leave no room in front of it
FARTHEST = 50.0  # where rays end, in distances at which points lie
CLOSEST = 0.5  # where they begin, in the smallest distances of points from a camera


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box in world coordinates and three distances along rays.

    Attributes:
        center: Its centre, world units.
        half: Half of its sides.
        near: Where rays begin.
        middle: Up to where samples are spread evenly by distance; beyond it by inverse distance.
        far: Where rays end.
    """

    center: tuple[float, float, float]
    half: tuple[float, float, float]
    near: float
    middle: float
    far: float

    def __post_init__(self) -> None:
        if not min(self.half) > 0 or not 0 < self.near < self.middle < self.far:
            raise ValueError(f"a box must have half sides > 0 and 0 < near < middle < far, got {self}")

    @property
    def unit(self) -> float:
        """Length in which densities count: half of the longest side."""
        return max(self.half)

    def record(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)


def box_of(centers: Tensor, points: Tensor) -> Box:
    """The box around first points, and how far from the cameras these lie.

    Args:
        centers: Of the cameras, [C, 3].
        points: First points of the scene, [P, 3].

    Raises:
        ValueError: If there are no points, or one is not finite.
    """
    points, centers = points.detach().double().cpu(), centers.detach().double().cpu()
    if not len(points) or not torch.isfinite(points).all() or not torch.isfinite(centers).all():
        raise ValueError(f"a field needs finite first points and cameras for its bounds, got {len(points)} points: "
                         "check the camera source")  # fmt: skip
    low, high = (_quantile(points, q) for q in (OUTLIERS, 1 - OUTLIERS))
    half = MARGIN * (high - low) / 2
    longest = float(half.max())
    if not longest > 0:  # one place: the cameras' distance is the only length there is
        longest = float((centers - points[0]).norm(dim=1).max()) or 1.0
    half = half.clamp_min(THINNEST * longest)
    some = points[:: max(1, len(points) // 5000)]
    distances = (some[None] - centers[:, None]).norm(dim=-1).flatten()[:, None]
    middle = MARGIN * float(_quantile(distances, 1 - OUTLIERS)) or longest
    # The floor: a camera on a point would divide by 0.
    near = max(CLOSEST * float(_quantile(distances, OUTLIERS / 5)), 1e-3 * middle)
    x, y, z = ((low + high) / 2).tolist()
    a, b, c = half.tolist()
    return Box(center=(x, y, z), half=(a, b, c), near=min(near, 0.5 * middle), middle=middle, far=FARTHEST * middle)


def _quantile(values: Tensor, q: float) -> Tensor:
    """Quantile of every column; `torch.quantile` refuses more than 16 million values."""
    place = min(len(values), max(1, 1 + round(q * (len(values) - 1))))
    return values.kthvalue(place, dim=0).values


def contracted(points: Tensor, box: Box) -> Tensor:
    """World points [..., 3] in the unit cube; the reference for the kernels."""
    center, half = points.new_tensor(box.center), points.new_tensor(box.half)
    x = (points - center) / half
    r = x.abs().amax(-1, keepdim=True).clamp_min(1.0)
    f = 1 + SHELL - SHELL / (1 + (r - 1) / SHELL)
    return (x * f / r + 1 + SHELL) / (2 + 2 * SHELL)


INNER = 0.75  # share of the samples before `middle`


def distance_at(s: Tensor, box: Box) -> Tensor:
    """Distance along a ray at s in 0..1, any shape; the reference for the kernels."""
    inner = box.near + (box.middle - box.near) * s / INNER
    outer = box.middle / (1 - (s - INNER).clamp_min(0) / (1 - INNER) * (1 - box.middle / box.far))
    return torch.where(s <= INNER, inner, outer)
