"""What every reconstruction method takes and returns: arrays in, Gaussians out. Methods know no folders."""

from dataclasses import dataclass, field
from typing import Any, Protocol

from torch import Tensor

from novags.splats.gaussians import Gaussians
from novags.splats.views import Views


class SceneStart(Protocol):
    """Where the Gaussians start; any object with these attributes will do (`novags.cameras.InitialScene`, say)."""

    @property
    def points(self) -> Tensor:
        """[P, 3] float32, world units."""
        ...

    @property
    def colors(self) -> Tensor:
        """[P, 3] float32, 0..1."""
        ...

    @property
    def extent(self) -> float:
        """Size of the scene that learning rates are relative to, world units."""
        ...


@dataclass(frozen=True, kw_only=True)
class MethodInput:
    """One reconstruction problem: the training views and what was seen in them.

    Attributes:
        views: Training cameras (C of them).
        dark: Images [C, H, W, 3], sRGB-encoded, 0..1.
        clean: The same exposures without noise, same shape and encoding; only the oracle may look. None if unknown.
        init: Initial points.
        seed: Of every random choice.
    """

    views: Views
    dark: Tensor
    clean: Tensor | None
    init: SceneStart
    seed: int

    def __post_init__(self) -> None:
        want = (len(self.views), self.views.height, self.views.width, 3)
        for name, value in (("dark", self.dark), ("clean", self.clean)):
            if value is not None and value.shape != want:
                raise ValueError(f"{name} must be [C, H, W, 3] = {list(want)} like the views, got {list(value.shape)}")


@dataclass(kw_only=True)
class MethodResult:
    """What a method made of it.

    Attributes:
        gaussians: The scene.
        enhanced: Enhanced dark images [C, H, W, 3].
        targets: What the fit finally aimed at [C, H, W, 3] (the denoised images, where a method denoises).
        losses: Log entries of the fit.
        seconds: Wall time per stage.
        config: The resolved configuration.
    """

    gaussians: Gaussians
    enhanced: Tensor
    targets: Tensor
    losses: list[dict[str, float]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
