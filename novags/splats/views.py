"""A set of pinhole cameras with one image size."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Views:
    """Cameras in OpenCV convention (x right, y down, z forward; pixel centres at +0.5).

    Attributes:
        viewmats: World to camera [C, 4, 4], float32.
        Ks: Intrinsics in pixels [C, 3, 3], float32.
        width: Pixels.
        height: Pixels.
    """

    viewmats: Tensor
    Ks: Tensor
    width: int
    height: int

    def __post_init__(self) -> None:
        c = len(self.viewmats)
        if self.viewmats.shape != (c, 4, 4) or self.Ks.shape != (c, 3, 3):
            raise ValueError(
                f"viewmats, Ks must be [C, 4, 4], [C, 3, 3], got {list(self.viewmats.shape)}, {list(self.Ks.shape)}"
            )
        if self.viewmats.dtype != torch.float32 or self.Ks.dtype != torch.float32:
            raise ValueError(f"viewmats and Ks must be float32, got {self.viewmats.dtype} and {self.Ks.dtype}")

    def to(self, device: torch.device | str) -> "Views":
        """The same cameras on a device."""
        return Views(self.viewmats.to(device), self.Ks.to(device), self.width, self.height)

    def __len__(self) -> int:
        return len(self.viewmats)

    def each(self) -> Iterator["Views"]:
        """Its cameras, one by one, each as a set."""
        for view in range(len(self)):
            one = slice(view, view + 1)
            yield Views(self.viewmats[one], self.Ks[one], self.width, self.height)

    @property
    def centers(self) -> Tensor:
        """Camera centres in the world [C, 3]."""
        return -(self.viewmats[:, :3, :3].mT @ self.viewmats[:, :3, 3:])[..., 0]

    @property
    def extent(self) -> float:
        """Scene extent as in 3DGS: 1.1 times the largest distance of a camera from their mean; 1 for one place."""
        distance = float((self.centers - self.centers.mean(0)).norm(dim=-1).max().detach())
        # Cameras that only turn have centres that differ by rounding: as an extent, that would let nothing move.
        rounding = 8 * torch.finfo(torch.float32).eps * float(self.viewmats[:, :3, 3].norm(dim=-1).max().detach())
        return 1.1 * distance if distance > rounding else 1.0
