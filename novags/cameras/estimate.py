"""The result of every camera source: cameras for the views it could place, and points to start from, in one frame."""

import math
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.splats.views import Views
from simscenes.rigs import Rig

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CameraEstimate:
    """Cameras and initial points, in the source's own frame: any similarity of the true one.

    Attributes:
        registered: Indices, among the C requested views, of the views that have a camera; increasing.
        rig: One camera for each registered view, of the size of the views.
        points: [P, 3] float32, units of the source's frame.
        colors: [P, 3] float32, 0..1, as the dark images show them.
        extent: 1.1 times the largest distance of a camera from the mean camera, units of the source's frame.
        made_of: Where the points come from, in words that complete "8000 points", and how many of each.

    Raises:
        ValueError: If shapes disagree, positions do not increase, or a value is not finite.
    """

    registered: tuple[int, ...]
    rig: Rig
    points: Tensor
    colors: Tensor
    extent: float
    made_of: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count, shape = len(self.registered), list(self.points.shape)
        if len(self.rig) != count or shape != [len(self.points), 3] or self.colors.shape != self.points.shape:
            raise ValueError(
                f"the rig must have one camera for each of {count} registered views, and points and colors must be "
                f"[P, 3], got {len(self.rig)} cameras, {shape} and {list(self.colors.shape)}"
            )
        if list(self.registered) != sorted(set(self.registered)) or min(self.registered, default=0) < 0:
            raise ValueError(f"registered must hold increasing positions >= 0, got {self.registered}")
        _check_finite(points=self.points, colors=self.colors)

    @property
    def viewmats(self) -> Tensor:
        """[R, 4, 4] float64, world to camera."""
        return torch.tensor(self.rig.viewmats)

    @property
    def Ks(self) -> Tensor:
        """[R, 3, 3] float64, pixels, pixel centres at +0.5."""
        return torch.tensor(self.rig.Ks)


def _check_finite(**values: Tensor) -> None:
    for name, value in values.items():
        if not torch.isfinite(value).all():
            raise ValueError(f"{name} of a camera estimate must be finite; the camera source failed")


def as_estimate(
    registered: tuple[int, ...],
    viewmats: Array,
    Ks: Array,
    points: Array,
    colors: Array,
    extent: float | None = None,
    *,
    size: tuple[int, int],
    made_of: dict[str, int],
) -> CameraEstimate:
    """The estimate in its types; `size` is width and height of the views, `extent` None the cameras' own.

    Raises:
        ValueError: As `CameraEstimate`, and if the cameras are not finite or cannot form a `Rig`.
    """
    _check_finite(viewmats=torch.as_tensor(viewmats), Ks=torch.as_tensor(Ks))
    return CameraEstimate(
        registered=registered,
        rig=Rig(viewmats=viewmats, Ks=Ks, width=size[0], height=size[1]),
        points=torch.tensor(points, dtype=torch.float32),
        colors=torch.tensor(colors, dtype=torch.float32),
        extent=extent_of(viewmats) if extent is None else extent,
        made_of={what: count for what, count in made_of.items() if count},
    )


def centers_of(viewmats: Array) -> Array:
    """Camera centres [C, 3] of world-to-camera matrices [C, 4, 4]."""
    return -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3])


FAR = 100.0  # scene extents; float32 then places a point to 1e-5 of the extent, a hundredth of a pixel or so


def near_origin(viewmats: Array) -> tuple[float, float, float]:
    """Where the origin of the world should lie, so that float32 resolves a scene with these cameras [C, 4, 4].

    It stays at zero, which changes no bit, unless the mean camera is more than `FAR` scene extents away from zero, as
    in national grids (UTM). Then it is the mean camera, rounded to whole units or, for a small scene, to the largest
    decimal step (tenths, hundredths, ...) that is not longer than `FAR` extents.
    """
    centers = centers_of(viewmats)
    middle = centers.mean(0)
    extent = float(np.linalg.norm(centers - middle, axis=1).max()) or 1.0
    if np.abs(middle).max() <= FAR * extent:
        return 0.0, 0.0, 0.0
    digits = max(0, -math.floor(math.log10(FAR * extent)))
    x, y, z = (float(v) for v in np.round(middle, digits))
    return x, y, z


def extent_of(viewmats: Array) -> float:
    """Extent of the scene as the engine defines it (`Views.extent`) for cameras [C, 4, 4]."""
    count = len(viewmats)
    return Views(torch.tensor(viewmats, dtype=torch.float32), torch.eye(3).repeat(count, 1, 1), 1, 1).extent
