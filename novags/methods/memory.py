"""The main memory of a run, said before it begins."""

from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from typing import Any

from novags.splats.training.config import FitConfig

PICTURE = 12.0  # bytes of a pixel of a picture in float32, red, green and blue
MANY = 1 << 18  # pixels of a picture, from which on a CPU's memory matters more than the time that it costs
CUDA = 0.36e9  # bytes more that torch takes, on a CPU too, where it was installed with CUDA (2.13.0: 0.59 for 0.22 GB)


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Figures of a method, measured on captures of several sizes.

    Attributes:
        fixed: Bytes whatever the capture, with all libraries but CUDA's.
        gaussian: Bytes for each of the Gaussians that a run ends with.
        pictures: How many float32 pictures of all training views are there at once.
        work: How many pictures of its size the work on one view takes.
    """

    fixed: float = 0.5e9
    gaussian: float = 1100.0
    pictures: float = 2.0
    work: float = 48.0

    def __call__(self, config: Any, views: float, pixels: float, points: int) -> float:
        """Bytes at the peak of a run on the CPU.

        Args:
            config: Of the method; with a fit of Gaussians, how many they become.
            views: Training views.
            pixels: Of one view.
            points: First points.
        """
        return self.peak(views, pixels, most_gaussians(config, points))

    def peak(self, views: float, pixels: float, gaussians: float) -> float:
        """The same for a known number of Gaussians."""
        fixed = self.fixed + (CUDA if has_cuda_libraries() else 0)
        return fixed + self.gaussian * gaussians + PICTURE * pixels * (self.pictures * views + self.work)


@cache
def has_cuda_libraries() -> bool:
    """Whether torch came with the libraries of CUDA; without importing it, which takes seconds."""
    return find_spec("nvidia") is not None


def most_gaussians(config: Any, points: int) -> int:
    """How many Gaussians a run ends with; none without a fit of them."""
    fit = getattr(config, "fit", None)
    if not isinstance(fit, FitConfig):
        return 0
    return replace(fit, cap_max=points if fit.cap_max is None else fit.cap_max).most(points)
