"""The result of a method: a scene that can be rendered and saved, and how it came about."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

from torch import Tensor

from novags.methods.enhancers.enhancer import NETWORK
from novags.splats.files.tensors import write_tensors
from novags.splats.views import Views

Space = Literal["enhanced", "linear", "lit"]
Progress = Callable[[int, int, dict[str, float]], None]  # steps done, of how many, losses


def counted_on(progress: Progress | None, before: int, after: int = 0) -> Progress | None:
    """The progress of a part of a method: so many steps are before it, and so many follow."""

    def report(done: int, total: int, entry: dict[str, float]) -> None:
        if progress is not None:
            progress(before + done, before + total + after, entry)

    return progress and report


class ReconstructedScene(Protocol):
    """A reconstructed scene of any kind."""

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """Image [C, H, W, 3], alpha [C, H, W] in 0..1, z-depth [C, H, W] (0 where there is nothing).

        The depth is the weighted mean along the ray (Gaussians), or the depth that halves its weight (fields).
        """
        ...

    def save(self, folder: Path) -> None:
        """Write the scene into an existing folder, in formats that others read."""
        ...

    def facts(self) -> dict[str, Any]:
        """For the record: numbers of primitives, parameters and bytes."""
        ...


@dataclass(kw_only=True)
class Reconstruction:
    """The outcome of one method.

    Attributes:
        scene: The scene, to render and save.
        space: The meaning of its colours: "enhanced" (the dark pictures brightened), "linear" (the scene's light, any
            exposure), "lit" (as in good light, sRGB).
        config: The resolved configuration; `dataclasses.asdict` of it is saved.
        enhancement: The enhancement of the dark pictures, for methods in the space "enhanced": {"enhancer", "pictures",
            "config"}. The noise-free exposure goes through the same before renders are compared with it. A method in
            the space "linear" may state one too: its renders then go through it, with the parameters that the training
            views have on average, and are compared like the renders of methods that enhance.
        enhanced: The enhanced training pictures [C, H, W, 3], or None.
        targets: The pictures that the scene was finally fitted to [C, H, W, 3] (denoised pictures, say), or None.
        along: The scene after fewer iterations of the same fit, by their number, as `fit.keep_at` of the configuration
            asks; empty where more than Gaussians was trained.
        viewmats: The training cameras at the end of training [C, 4, 4]; None: unchanged.
        losses: Log entries of the training.
        seconds: Wall time by part.
        found: Its measurements and decisions on the way, for the record; plain values.
        network: Weights of the network that enhanced the pictures, by name, for methods with one. `save` writes them
            too, to `NETWORK`, which the configuration of the enhancement names.
    """

    scene: ReconstructedScene
    space: Space
    config: Any
    enhancement: dict[str, Any] | None = None
    enhanced: Tensor | None = None
    targets: Tensor | None = None
    along: Mapping[int, ReconstructedScene] = field(default_factory=dict)
    viewmats: Tensor | None = None
    losses: list[dict[str, float]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    found: dict[str, Any] = field(default_factory=dict)
    network: dict[str, Tensor] | None = None

    def __post_init__(self) -> None:
        if (self.space == "enhanced" and self.enhancement is None) or (self.space == "lit" and self.enhancement):
            raise ValueError(
                "a reconstruction in the space 'enhanced' states its enhancement, and one in the space 'lit' does not, "
                f"got {self.space!r} with {self.enhancement}"
            )

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """See `ReconstructedScene.render`."""
        return self.scene.render(views)

    def save(self, folder: Path) -> None:
        """See `ReconstructedScene.save`."""
        self.scene.save(folder)
        if self.network is not None:
            write_tensors(folder / NETWORK, self.network)
