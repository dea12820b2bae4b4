"""How a fit is done, and its schedules."""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from novags.numbers import POINTS, STEPS, check_range

from .updates.adam import LearningRates
from .updates.camera_refinement import CameraRefinement
from .updates.mcmc import McmcConfig

NEAR = 0.01  # in units: the default of `rasterize`
USUAL = (0.5, 8.0)  # extents of scenes that are fitted in their own units; those measured have 0.8 to 4.5
UNUSUAL = 2.0  # the extent that all other scenes are scaled to


@dataclass(frozen=True, kw_only=True)
class FitConfig:
    """How to train.

    Attributes:
        iterations: Optimiser steps.
        cap_max: Largest number of Gaussians; None is as many as there are at the start.
        sh_degree: Highest spherical-harmonics degree, 0..3.
        sh_every: Iterations after which the degree rises by one; it starts at 0.
        dssim_weight: w in (1 - w) L1 + w (1 - SSIM); 0 is L1 alone.
        opacity_reg: Weight of the mean opacity.
        opacity_reg_fall: p in `opacity_reg` * (1 - t)**p, its weight after the share t of the run; 0 keeps it.
        scale_reg: Weight of the mean scale, in units of `unit`.
        rates: Learning rates.
        mcmc: When Gaussians move; None keeps the population as it is.
        refine_cameras: How the training cameras are refined; None takes them as they are given.
        extent: Scene size that the rates of the means and of the cameras are relative to, world units; `fit` measures
            it from the cameras where it is None.
        seed: Of the order of views, of relocation and of noise.
        eps2d: Variance added to every splat on the image, px^2.
        antialiased: Whether opacities fall where `eps2d` makes a splat larger; `rasterize_mode` of `rasterize`.
        backend: As in `rasterize`.
        checkpoint_every: Iterations between checkpoints.
    """

    iterations: int = 7000
    cap_max: int | None = None
    sh_degree: int = 3
    sh_every: int = 1000
    dssim_weight: float = 0.2
    opacity_reg: float = 0.01
    opacity_reg_fall: float = 0.0
    scale_reg: float = 0.01
    rates: LearningRates = field(default_factory=LearningRates)
    mcmc: McmcConfig | None = field(default_factory=McmcConfig)
    refine_cameras: CameraRefinement | None = None
    extent: float | None = None
    seed: int = 0
    eps2d: float = 0.3
    antialiased: bool = False
    backend: str = "auto"
    checkpoint_every: int = 1000

    def __post_init__(self) -> None:
        check_range("iterations", self.iterations, 0, STEPS)
        check_range("sh_every", self.sh_every, 1, STEPS)
        check_range("checkpoint_every", self.checkpoint_every, 1, STEPS)
        if self.cap_max is not None:
            check_range("cap_max", self.cap_max, 1, POINTS)
        if self.sh_degree not in (0, 1, 2, 3):
            raise ValueError(f"sh_degree must be 0, 1, 2 or 3, got {self.sh_degree}")
        if not 0 <= self.opacity_reg_fall < math.inf:
            raise ValueError(f"opacity_reg_fall must be finite and >= 0, got {self.opacity_reg_fall}")
        if not 0 <= self.dssim_weight <= 1 or self.opacity_reg < 0 or self.scale_reg < 0:
            raise ValueError(
                "dssim_weight must lie in 0..1 and the regularisers be >= 0, got "
                f"{self.dssim_weight}, {self.opacity_reg} and {self.scale_reg}"
            )
        if not 0 <= self.eps2d < math.inf:
            raise ValueError(f"eps2d must be finite and >= 0 px^2, got {self.eps2d}")
        if self.extent is not None and not self.extent > 0:
            raise ValueError(f"extent must be > 0 or None, got {self.extent}")

    @property
    def unit(self) -> float:
        """World units per unit of length of the fit: 1 for a scene of usual size, else what gives it extent `UNUSUAL`.

        Otherwise, in millimetres instead of metres, regularisation would flatten all splats, and a scene a thousandth
        of a unit in size would lie in front of the near plane.

        Raises:
            ValueError: If the extent is not known yet.
        """
        if self.extent is None:
            raise ValueError(
                "extent must be known to say how Gaussians are trained and shown, got None: take the config of the "
                "FitResult, or set extent=views.extent"
            )
        if USUAL[0] <= self.extent <= USUAL[1]:
            return 1.0
        return self.extent / UNUSUAL

    @property
    def near_plane(self) -> float:
        """Smallest camera z that is rendered, world units."""
        return NEAR * self.unit

    @property
    def splatting(self) -> dict[str, Any]:
        """Arguments of `rasterize` that show the Gaussians as they were trained."""
        mode = "antialiased" if self.antialiased else "classic"
        return {"eps2d": self.eps2d, "rasterize_mode": mode, "near_plane": self.near_plane}

    def opacity_reg_at(self, iteration: int) -> float:
        """Weight of the mean opacity in an iteration."""
        left = 1 - iteration / self.iterations
        return float(self.opacity_reg * left**self.opacity_reg_fall)

    def degree_at(self, iteration: int) -> int:
        """Degree of the harmonics that an iteration renders."""
        return min(self.sh_degree, iteration // self.sh_every)

    def view_at(self, iteration: int, n_views: int) -> int:
        """Every epoch visits all views once, in a new random order."""
        epoch, position = divmod(iteration, n_views)
        return _order(epoch, n_views, self.seed)[position]


@lru_cache(2)
def _order(epoch: int, n_views: int, seed: int) -> list[int]:
    order: list[int] = np.random.default_rng([seed, epoch]).permutation(n_views).tolist()
    return order
