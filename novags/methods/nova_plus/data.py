"""The measurements of a problem, split into a part that fits may see and a part held out to judge them."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from novags.methods.light import MeasuredLight, problem_light
from novags.methods.noise import Noise
from novags.methods.problem import Problem, refuse_uneven

FULL = 0.98  # of white: a datum at or above it counts as saturated


@dataclass(frozen=True, kw_only=True)
class LightMeasurements(MeasuredLight):
    """The training pictures as measurements of light.

    Attributes:
        held: Pixels that no fit sees, bool [C, H, W]; they judge the fits. None where data share their noise: a pixel's
            noise would be in its neighbours, which fits see.
    """

    held: Tensor

    @property
    def fitted(self) -> Tensor:
        """The data that fits may see, [C, H, W, 3], nan elsewhere."""
        return torch.where(self.held[..., None], torch.nan, self.light)

    def fitted_of(self, view: int) -> Tensor:
        """Those of one view, [H, W, 3]."""
        return torch.where(self.held[view, ..., None], torch.nan, self.light[view])

    def some(self, views: slice | list[int]) -> "LightMeasurements":
        """The measurements of some views."""
        return replace(self, light=self.light[views], held=self.held[views])

    @property
    def greens(self) -> Tensor:
        """All measurements of green, [n]."""
        green = self.light[..., 1]
        return green[~green.isnan()]


def exposures(problem: Problem, noise: Noise, held_share: float) -> LightMeasurements:
    """The measurements of a problem.

    Args:
        problem: The problem.
        noise: Of its pictures.
        held_share: Of the pixels, drawn by the problem's seed, to be held out where noise is independent; 0..1.

    Raises:
        LacksInput: As `measured_light` says, and for views of several exposures.
    """
    refuse_uneven(problem.exposures, "a fit of data by their likelihood")
    shared = problem.channels_share + problem.pixels_share
    found = problem_light(problem, noise, shared)
    generator = torch.Generator().manual_seed(problem.seed)
    held = torch.rand(found.light.shape[:3], generator=generator) < (0.0 if found.shared else held_share)
    return LightMeasurements(**vars(found), held=held.to(found.light.device))
