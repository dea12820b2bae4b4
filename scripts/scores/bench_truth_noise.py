"""What the noise of a rendered truth does to scores: the same pictures against few samples, and against 16 times as
many.

    .venv/bin/python scripts/scores/bench_truth_noise.py [--size 64] [--spp 96] [--views 8] [--scenes NAME …]

Each scene is rendered three times, with seeds of their own: the truth, a better truth of 16 times the samples, and a
third set of half the samples, which a blur makes the pictures that are scored. The better truth goes through the
exposure and the enhancement of the first. A line for each scene, reference and score, means over the views: as
measured; corrected, with its standard error by the truth's noise; against the better truth, with its own; how many of
these errors apart. Of scores that are not corrected: the measured bias, and the bias against the better truth.
"""

import argparse
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from novags.methods.enhancers import ENHANCERS
from novags.settings import flattened
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.set import Source, open_source
from novags.testbed.folders.truth_noise import over, references_at
from novags.testbed.ledger.contents import jsonable
from novags.testbed.metrics.images import gaussian_blur, image_scores, mean_scores
from novags.testbed.metrics.truth import BIAS, ERROR
from novags.testbed.stages.capturing import capture
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.rendering import render

SCENES = ("tabletop", "cornell", "bookshop", "busts")
BETTER = 16  # times the samples
QUIET = Console(quiet=True)
ENHANCEMENT = {"enhancer": "guided", "pictures": "8bit", "config": jsonable(flattened(ENHANCERS["guided"].config()))}
RUN: Any = SimpleNamespace(enhancement=ENHANCEMENT, space="enhanced", lacks=None)


def compared(scene: str, folder: Path, size: int, spp: int, views: int) -> dict[str, list[Mapping[str, Any]]]:
    """Scores against the truth, and against the better truth, as means over all views, by reference."""
    sets = []
    for seed, samples in enumerate((spp, BETTER * spp, spp // 2)):
        path = folder / f"{scene}-{seed}"
        shape: dict[str, Any] = {"n_views": views, "width": size, "height": size}
        render(path, RenderConfig(scene=scene, spp=samples, truth_samples=1, seed=seed, **shape), QUIET)
        sets.append(open_source(path, QUIET))
    dark = folder / f"{scene}-dark"
    capture(folder / f"{scene}-0", dark, CaptureConfig(), QUIET)
    found: dict[str, list[list[Mapping[str, Any]]]] = {}
    for i in range(views):
        for kind, scores in _view(sets, dark, i).items():
            found.setdefault(kind, []).append(scores)
    return {kind: [mean_scores(each) for each in zip(*scores, strict=True)] for kind, scores in found.items()}


def _view(sets: list[Source], dark: Path, i: int) -> dict[str, list[Mapping[str, Any]]]:
    captured, first = open_capture(dark), sets[0].radiance(i)

    def at(light: np.ndarray) -> dict[str, np.ndarray]:
        return references_at(RUN, captured, sets[0], i, over(light, first))

    picture = {kind: gaussian_blur(image, 0.7) for kind, image in at(sets[2].radiance(i)).items()}
    found: dict[str, list[Mapping[str, Any]]] = {kind: [] for kind in picture}
    for truth in sets[:2]:
        light, half = truth.radiance(i), truth.half(i)
        assert half is not None
        mean, more, less = at(light), at(light + half), at(light - half)
        for kind, scores in found.items():
            scores.append(image_scores(picture[kind], mean[kind], halves=(more[kind], less[kind])))
            plain = image_scores(picture[kind], mean[kind])
            scores[-1] = {**scores[-1], **{f"plain_{name}": value for name, value in plain.items()}}
    return found


def line(scene: str, kind: str, name: str, here: Mapping[str, Any], better: Mapping[str, Any]) -> str:
    """One score."""
    start = f"{scene:10} {kind:9} {name:18} {here[f'plain_{name}']:8.3f}"
    if name + ERROR in here:
        errors = here[name + ERROR], better[name + ERROR]
        apart = (here[name] - better[name]) / np.hypot(*errors)
        return (f"{start}  corrected {here[name]:7.3f} ± {errors[0]:.3f}  better truth {better[name]:7.3f} ± "
                f"{errors[1]:.3f}  {apart:+5.1f} errors apart")  # fmt: skip
    true = better[name] - better[name + BIAS]
    return f"{start}  bias measured {here[name + BIAS]:+8.4f}  against the better truth {here[name] - true:+8.4f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--spp", type=int, default=96)
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for scene in asked.scenes:
            for kind, (here, better) in compared(scene, Path(folder), asked.size, asked.spp, asked.views).items():
                for name in here:
                    if name + ERROR in here or name + BIAS in here:
                        print(line(scene, kind, name, here, better), flush=True)


if __name__ == "__main__":
    main()
