"""How a fit is done, and its schedules."""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from novags.numbers import POINTS, STEPS, check_range

NEAR = 0.01  # in units: the default of `rasterize`
USUAL = (0.5, 8.0)  # extents of scenes that are fitted in their own units; those measured have 0.8 to 4.5
UNUSUAL = 2.0  # the extent that all other scenes are scaled to


COOLED = ("quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest", "features")  # by `cool_to`


@dataclass(frozen=True, kw_only=True)
class LearningRates:
    """Learning rates of 3DGS (per iteration).

    Attributes:
        means: At the start, in units of the scene extent.
        means_final: At the end of the schedule, same units; log-linear in between, so > 0 unless `means` is 0.
        schedule: "original": `means_final` is reached after 30,000 iterations, however long the run (3DGS, 3DGS-MCMC);
            "gsplat": at the end of the run.
        quats: Rotation.
        log_scales: Log scale.
        logit_opacities: Logit opacity.
        sh_dc: Constant colour.
        sh_rest: Higher spherical harmonics.
        features: `Gaussians.features`.
        cool_from: Share of the run after which all rates fall log-linearly, except the means' rate.
        cool_to: Rates at its end, as a share of themselves; 1: they do not fall.
    """

    means: float = 1.6e-4
    means_final: float = 1.6e-6
    schedule: str = "gsplat"
    quats: float = 1e-3
    log_scales: float = 5e-3
    logit_opacities: float = 5e-2
    sh_dc: float = 2.5e-3
    sh_rest: float = 1.25e-4
    features: float = 2.5e-3
    cool_from: float = 0.6
    cool_to: float = 1.0

    def __post_init__(self) -> None:
        if self.schedule not in ("original", "gsplat"):
            raise ValueError(f"schedule must be 'original' or 'gsplat', got {self.schedule!r}")
        for name in ("means", "means_final", *COOLED):
            if not getattr(self, name) >= 0:
                raise ValueError(f"learning rate {name} must be >= 0, got {getattr(self, name)}")
        if self.means > 0 and self.means_final == 0:
            raise ValueError(
                f"means_final must be > 0 where means is (the rate falls log-linearly), got 0 and means {self.means}: "
                "take a small share of means, or means itself for a rate that does not fall"
            )
        if not (0 <= self.cool_from < 1 and 0 < self.cool_to <= 1):
            raise ValueError(
                f"cool_from must lie in [0, 1) and cool_to in (0, 1], got {self.cool_from} and {self.cool_to}"
            )

    def at(self, iteration: int, iterations: int) -> "LearningRates":
        """These rates at an `iteration` of a run of `iterations`: cooled, except the means' rates."""
        begin = self.cool_from * iterations
        if self.cool_to == 1 or iteration <= begin:
            return self
        factor = self.cool_to ** ((iteration - begin) / (iterations - begin))
        return replace(self, **{name: factor * getattr(self, name) for name in COOLED})

    def means_at(self, iteration: int, iterations: int, extent: float) -> float:
        """Learning rate of the means, world units, at `iteration` of a run of `iterations`."""
        if self.means == 0:
            return 0.0
        progress = min(1.0, iteration / (30_000 if self.schedule == "original" else max(1, iterations)))
        return extent * self.means * (self.means_final / self.means) ** progress


@dataclass(frozen=True, kw_only=True)
class McmcConfig:
    """When and how Gaussians move.

    Attributes:
        refine_start: Iteration after which Gaussians may be relocated and added.
        refine_stop: Iteration from which the population stays; None is 5/6 of the run (25,000 of 30,000).
        refine_every: Iterations between refinements.
        growth: Factor of growth per refinement, until the cap.
        noise_lr: Langevin noise in units of the learning rate of the means; None switches it off.
    """

    refine_start: int = 500
    refine_stop: int | None = None
    refine_every: int = 100
    growth: float = 1.05
    noise_lr: float | None = 5e5

    def __post_init__(self) -> None:
        if self.refine_start < 0 or self.refine_every < 1 or self.growth < 1:
            raise ValueError(
                "refine_start must be >= 0, refine_every >= 1 and growth >= 1, got "
                f"{self.refine_start}, {self.refine_every} and {self.growth}"
            )
        if self.noise_lr is not None and self.noise_lr < 0:
            raise ValueError(f"noise_lr must be >= 0 or None, got {self.noise_lr}")


@dataclass(frozen=True, kw_only=True)
class CameraRefinement:
    """How far and when the training cameras may move.

    Attributes:
        rotation_rate: Learning rate of the turns, rad per visit.
        translation_rate: Learning rate of the moves, scene extents per visit.
        start: First iteration that moves cameras; before it the Gaussians settle around the given ones.
        decay: Factor of both rates at the end of the run; log-linear from 1 at `start`.
        pull: Weight of the sum of squares of a camera's twist (rad^2, extents^2), added to the loss of its visits.
    """

    rotation_rate: float = 5e-3
    translation_rate: float = 2e-3
    start: int = 100
    decay: float = 0.1
    pull: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rotation_rate", "translation_rate", "pull"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} of camera refinement must be finite and >= 0, got {getattr(self, name)}")
        if self.start < 0:
            raise ValueError(f"start of camera refinement must be >= 0 iterations, got {self.start}")
        if not 0 < self.decay <= 1:
            raise ValueError(f"decay of camera refinement must lie in (0, 1], got {self.decay}")

    def factor_at(self, iteration: int, iterations: int) -> float:
        """Factor of both rates at `iteration` of a run of `iterations`; 0 before `start`."""
        if iteration < self.start:
            return 0.0
        return self.decay ** ((iteration - self.start) / max(1, iterations - self.start))


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
        mcmc: When Gaussians move; None keeps the population unchanged.
        refine_cameras: How the training cameras are refined; None takes them as given.
        extent: Scene size that the rates of the means and of the cameras are relative to, world units; `fit` measures
            it from the cameras where it is None.
        seed: Of the order of views, of relocation and of noise.
        eps2d: Variance added to every splat on the image, px^2.
        antialiased: Whether opacities fall where `eps2d` makes a splat larger; `rasterize_mode` of `rasterize`.
        backend: As in `rasterize`.
        checkpoint_every: Iterations between checkpoints.
        keep_at: Iterations after which a copy of the Gaussians is kept, to be scored along the run. The run itself is
            the same with and without.
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
    keep_at: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        check_range("iterations", self.iterations, 0, STEPS)
        check_range("sh_every", self.sh_every, 1, STEPS)
        check_range("checkpoint_every", self.checkpoint_every, 1, STEPS)
        for at in self.keep_at:
            check_range("keep_at", at, 1, STEPS)
        if self.keep_at and self.refine_cameras is not None:
            raise ValueError(
                f"keep_at must be empty where cameras are refined, got {self.keep_at}: what is kept would belong to "
                "the cameras of its own time"
            )
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
        """World units per unit of length of the fit: 1 for a scene of usual size, else the number that gives it extent
        `UNUSUAL`.

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
        """Arguments of `rasterize` that show the Gaussians as in training."""
        mode = "antialiased" if self.antialiased else "classic"
        return {"eps2d": self.eps2d, "rasterize_mode": mode, "near_plane": self.near_plane}

    @property
    def refine_stop(self) -> int:
        """Iteration from which the population stays."""
        stop = None if self.mcmc is None else self.mcmc.refine_stop
        return self.iterations * 5 // 6 if stop is None else stop

    def most(self, start: int) -> int:
        """How many Gaussians `start` of them are at the end."""
        cap = start if self.cap_max is None else self.cap_max
        found, mcmc = min(start, cap), self.mcmc
        if mcmc is None:
            return found
        last = (min(self.refine_stop, self.iterations) - 1) // mcmc.refine_every
        for _ in range(mcmc.refine_start // mcmc.refine_every, last):
            found = min(cap, int(mcmc.growth * found))
        return found

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
