"""The result of `rasterize` besides image and alpha: the third one, with the names and shapes of gsplat's."""

import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from torch import Tensor

LISTS = ("tiles_per_gauss", "isect_ids", "flatten_ids", "isect_offsets")


class Watch:
    """Puts the gradient of an image with respect to `info["means2d"]` where gsplat's strategies look for it.

    The graph of the CPU kernels does not contain that tensor: they go from the Gaussians to the image in one step. If
    it was asked to retain its gradient, or for absolute gradients, the backward pass of a camera adds them here.
    """

    def __init__(self, absgrad: bool) -> None:
        self.absgrad = absgrad
        self._tensor: Callable[[], Tensor | None] = lambda: None
        self._rows: list[Any] = []

    def attach(self, tensor: Tensor, rows: list[Any]) -> None:
        """`tensor` was handed out; rows[c] are (its rows, the Gaussians there) of camera c."""
        self._tensor, self._rows = weakref.ref(tensor), rows

    @property
    def wanted(self) -> bool:
        """Whether anybody will look at the gradients."""
        tensor = self._tensor()
        return tensor is not None and (self.absgrad or tensor.retains_grad)

    def add(self, camera: int, v_means2d: Tensor, v_absolute: Tensor | None) -> None:
        """Add the gradients [N, 2] of one camera's means2d, and the sums of their absolute values over pixels."""
        tensor = self._tensor()
        if tensor is None:
            return
        rows, members = self._rows[camera]
        if tensor.retains_grad:
            if tensor.grad is None:
                tensor.grad = torch.zeros_like(tensor)
            tensor.grad[rows] += v_means2d[members]
        if self.absgrad and v_absolute is not None:
            if getattr(tensor, "absgrad", None) is None:
                tensor.absgrad = torch.zeros_like(tensor)  # type: ignore[attr-defined]
            tensor.absgrad[rows] += v_absolute[members]  # type: ignore[attr-defined]


@dataclass(frozen=True, kw_only=True)
class Projected:
    """The Gaussians in one camera, in pixels.

    Attributes:
        means2d: [N, 2]; 0 where not visible.
        radius: [N] int32, the larger one of both axes, 0: not visible.
        depths: [N], camera z.
        footprint: Gives radii [N, 2] int32 (0: not visible), conics [N, 3] (xx, xy, yy of the inverse covariance; any
            where not visible) and opacities [N] with compensation.
    """

    means2d: Tensor
    radius: Tensor
    depths: Tensor
    footprint: Callable[[], tuple[Tensor, Tensor, Tensor]]


class Info(Mapping[str, Any]):
    """A mapping whose values are made when they are asked for."""

    def __init__(self, values: Mapping[str, Callable[[], Any]]) -> None:
        self._make, self._made = dict(values), dict[str, Any]()

    def __getitem__(self, name: str) -> Any:
        if name in LISTS:
            raise KeyError(f"{name} is not provided: the tile lists of the CPU kernels are made in waves and dropped")
        if name not in self._made:
            self._made[name] = self._make[name]()
        return self._made[name]

    def __contains__(self, name: object) -> bool:
        return name in self._make

    def __iter__(self) -> Iterator[str]:
        return iter(self._make)

    def __len__(self) -> int:
        return len(self._make)


def describe(views: list[Projected], watch: Watch, *, width: int, height: int, packed: bool) -> Info:
    """Everything about the cameras' Gaussians as gsplat's `meta`, but for the tile lists."""

    @cache
    def ids() -> list[Tensor] | None:
        return [torch.nonzero(view.radius)[:, 0] for view in views] if packed else None

    def all_ids() -> Tensor | None:
        there = ids()
        return None if there is None else torch.cat(there)

    def camera_ids() -> Tensor | None:
        there = ids()
        return None if there is None else torch.cat([torch.full_like(i, c) for c, i in enumerate(there)])

    def joined(values: list[Tensor]) -> Tensor:
        there = ids()
        if there is not None:
            return torch.cat([value[i] for value, i in zip(values, there, strict=True)])
        return values[0][None] if len(values) == 1 else torch.stack(values)

    def means2d() -> Tensor:
        tensor, there = joined([view.means2d for view in views]), ids()
        rows: list[Any] = [(c, slice(None)) for c in range(len(views))]
        if there is not None:
            ends = torch.tensor([0, *(len(i) for i in there)]).cumsum(0).tolist()
            rows = [(slice(ends[c], ends[c + 1]), i) for c, i in enumerate(there)]
        watch.attach(tensor, rows)
        return tensor

    @cache
    def footprints() -> list[tuple[Tensor, ...]]:
        return list(zip(*(view.footprint() for view in views), strict=True))

    info = Info({
        "camera_ids": camera_ids, "gaussian_ids": all_ids,
        "means2d": means2d, "depths": lambda: joined([view.depths for view in views]),
        "visible": lambda: joined([view.radius > 0 for view in views]),  # not of gsplat: spares the radii
        "radii": lambda: joined(list(footprints()[0])), "conics": lambda: joined(list(footprints()[1])),
        "opacities": lambda: joined(list(footprints()[2])),
        "width": lambda: width, "height": lambda: height, "n_batches": lambda: 1, "n_cameras": lambda: len(views),
        "tile_size": lambda: 16, "tile_width": lambda: -(-width // 16), "tile_height": lambda: -(-height // 16),
    })  # fmt: skip
    if watch.absgrad:  # the backward pass looks for the tensor
        info["means2d"]
    return info
