"""How a field is fitted."""

import math
from dataclasses import dataclass, field

from novags.fields.layout import FieldLayout
from novags.numbers import PIXELS, STEPS, check_range


@dataclass(frozen=True, kw_only=True)
class FieldFitConfig:
    """How to train.

    Attributes:
        iterations: Optimiser steps.
        rays: Per step.
        patch: Side of the squares of neighbouring pixels that rays come in; 1: pixels by themselves.
        samples: Per ray.
        rate: Learning rate of the tables and of the network at the start (Adam).
        rate_end: Share of it that is left at the end; in between it falls log-linearly.
        warm: Steps in which it rises linearly.
        even: Share of the samples that is spread evenly over the ray.
        distortion: Weight of the distortion loss of mip-NeRF 360, which draws a ray's weights together; 0: none.
        table_decay: Weight of the mean over the levels of the mean squared feature of a level's table, which keeps
            features small that few samples meet (Zip-NeRF, Barron et al. 2023, takes the sum over the levels); 0: none.
        near_scale: Gradients of samples nearer than this share of the scene's reach (`Box.middle`) fall with the square
            of the distance: there, few pixels decide alone, and fog before a camera would explain its picture
            (Philip and Deschaintre 2023, "Floaters no more"); 0: they do not.
        anchored: Weight of the loss at the first points, where a method says so; see `Anchors`.
        points: Whether the field starts dense where the first points are; if not, it starts as fog.
        layout: Sizes of the field; a method adds its outputs.
        seed: Of every random choice.
        checkpoint_every: Steps between checkpoints.
    """

    iterations: int = 7000
    rays: int = 512
    patch: int = 1
    samples: int = 96
    rate: float = 1e-2
    rate_end: float = 0.03
    warm: int = 50
    even: float = 0.25
    distortion: float = 1e-3
    table_decay: float = 0.0
    near_scale: float = 0.15
    anchored: float = 0.1
    points: bool = True
    layout: FieldLayout = field(default_factory=FieldLayout)
    seed: int = 0
    checkpoint_every: int = 500

    def __post_init__(self) -> None:
        for name, least in (("iterations", 0), ("rays", 1), ("patch", 1), ("samples", 1), ("warm", 0),
                            ("checkpoint_every", 1)):  # fmt: skip
            check_range(name, getattr(self, name), least, STEPS)
        check_range("rays x samples", self.rays * self.samples, 1, PIXELS)
        if self.rays % self.patch**2:
            raise ValueError(f"rays must be a multiple of patch^2, got {self.rays} and a patch of {self.patch}")
        if not (0 < self.rate < math.inf and 0 < self.rate_end <= 1):
            raise ValueError(f"rate must be > 0 and rate_end in (0, 1], got {self.rate} and {self.rate_end}")
        for name in ("near_scale", "anchored", "table_decay"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be finite and >= 0, got {getattr(self, name)}")
        if not 0 <= self.even <= 1 or not 0 <= self.distortion < math.inf:
            raise ValueError(f"even must lie in 0..1 and distortion be >= 0, got {self.even} and {self.distortion}")

    def rate_at(self, iteration: int) -> float:
        """Learning rate of a step."""
        rise = min(1.0, (iteration + 1) / max(1, self.warm))
        return float(self.rate * rise * self.rate_end ** (iteration / max(1, self.iterations)))
