"""Several fits of one method to the same pictures, each with random numbers of its own, shown as their mean.

What a fit makes of its random numbers differs from fit to fit, and a mean over fits has less of it. Entries of the
NTIRE 2026 challenge average five to ninety-one models by pixel; `NAME*3` does that with any method.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from novags.methods.reconstruction import Progress, ReconstructedScene, Reconstruction
from novags.methods.variant import Method
from novags.splats.views import Views

if TYPE_CHECKING:
    from novags.methods.problem import Problem

FITS = "fits"  # in the record: the facts of each scene


@dataclass(frozen=True)
class MeanScene:
    """The mean of several scenes of one frame, pixel by pixel, in the space of their colours."""

    scenes: Sequence[ReconstructedScene]

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """As `ReconstructedScene` says; the depth is the mean over scenes, weighted by their alphas."""
        rendered = [scene.render(views) for scene in self.scenes]
        images, alphas, depths = (torch.stack([one[k] for one in rendered]) for k in range(3))
        # Without the floor, a pixel that no scene covers would divide 0 by 0; its depth is 0.
        weight = alphas.sum(0).clamp_min(torch.finfo(alphas.dtype).tiny)
        return images.mean(0), alphas.mean(0), (alphas * depths).sum(0) / weight

    def save(self, folder: Path) -> None:
        """Write each scene into scene/fit-N, as a run of one fit would write it into its folder."""
        for scene, place in zip(self.scenes, places(folder, len(self.scenes)), strict=True):
            place.mkdir(parents=True, exist_ok=True)
            scene.save(place)

    def facts(self) -> dict[str, Any]:
        """The facts of each scene, and the sums of their numbers of things."""
        each = [scene.facts() for scene in self.scenes]
        sums = {name: sum(facts[name] for facts in each) for name, value in each[0].items() if type(value) is int}
        return {FITS: each, **sums}


def places(folder: Path, fits: int) -> list[Path]:
    """Where the scenes of a run of several fits are, in its folder."""
    return [folder / "scene" / f"fit-{k + 1}" for k in range(fits)]


def seed_of(seed: int, k: int) -> int:
    """The seed of the k-th fit, from 0: the first one has the run's own, so that it is the run of a single fit."""
    return seed if k == 0 else int(np.random.SeedSequence([seed, k]).generate_state(1)[0])


def train_several(
    method: Method, problem: "Problem", config: Any, fits: int, *, progress: Progress, checkpoint: Path
) -> Reconstruction:
    """Train a method so many times, and average; arguments as of `Method.train`.

    Returns:
        A reconstruction whose scene is the mean of all. Configuration, enhanced pictures and targets are of the first
        fit; losses and seconds of all.

    Raises:
        ValueError: As `Method.train` says; or if the fits end in different spaces or enhancements.
    """
    done = list[Reconstruction]()
    for k in range(fits):
        own = dataclasses.replace(problem, seed=seed_of(problem.seed, k))
        done.append(method.train(own, config, progress=_share(progress, k, fits), checkpoint=_place(checkpoint, k)))
        if k:
            done[k] = dataclasses.replace(done[k], enhanced=None, targets=None)  # of the first alone: they are large
    first = done[0]
    if any(each.space != first.space or each.enhancement != first.enhancement for each in done):
        raise ValueError("the fits of one method ended in different spaces or enhancements, which have no mean: "
                         "average no fits of it")  # fmt: skip
    return dataclasses.replace(
        first,
        scene=MeanScene([each.scene for each in done]),
        along=_along([each.along for each in done]),
        losses=[entry for each in done for entry in each.losses],
        seconds={part: sum(each.seconds.get(part, 0.0) for each in done) for part in first.seconds},
        found={FITS: [each.found for each in done]} if any(each.found for each in done) else {},
    )


def _share(progress: Progress, k: int, fits: int) -> Progress:
    return lambda done, total, losses: progress(k * total + done, fits * total, losses)


def _place(checkpoint: Path, k: int) -> Path:
    """The checkpoint of one fit, in a folder that is there while the run is under way."""
    place = checkpoint.parent / "checkpoints" / f"fit-{k + 1}" / checkpoint.name
    place.parent.mkdir(parents=True, exist_ok=True)
    return place


def _along(each: Sequence[Mapping[int, ReconstructedScene]]) -> dict[int, ReconstructedScene]:
    common = set.intersection(*(set(along) for along in each))
    return {at: MeanScene([along[at] for along in each]) for at in sorted(common)}
