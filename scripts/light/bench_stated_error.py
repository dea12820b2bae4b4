"""Does the error that a render states hold? Stated and measured error of every view, whole and by brightness.

    python scripts/light/bench_stated_error.py tabletop cornell hall --out build/stated.jsonl
    python scripts/light/bench_stated_error.py hall cornell --max-depth 3

Each scene is rendered to --target-error, and once more with other seeds, --times the samples of its largest view, and
paths four times as long. The error of a pixel is the difference between the two; its mean square, less the noise of
the second render, is the square of the measured error. Pixels are sorted by the light of the first render, as
`error_by_brightness` sorts them.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes import default_rig, plan_transport, render_set
from simscenes.rigs import Rig
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.exr import read_exr
from simscenes.transport.pilot import DEEPEST

LONGEST = 4  # times the path length of the plan, in the reference


def noise_square(folder: Path, name: str) -> NDArray[np.float64]:
    """Square of the noise of each pixel and channel, from the two halves of its samples, [h,w,3]."""
    channels, _ = read_exr(folder / "gt" / f"{name}.exr")
    return np.square(np.stack([channels[f"half.{c}"] for c in "RGB"], -1, dtype=np.float64))


def measured(light: NDArray[np.float64], truth: NDArray[np.float64], noise: NDArray[np.float64]) -> list[float]:
    """Relative RMSE of a view [h,w,3] and of its quarters, darkest first; `noise` is the square of the truth's own."""
    square, level = (np.square(light - truth) - noise).mean(-1).ravel(), light.mean(-1).ravel()
    order = np.argsort(level, kind="stable")
    return [
        float(np.sqrt(max(square[chosen].mean(), 0.0)) / level[chosen].mean())
        for chosen in (order, *np.array_split(order, 4))
    ]


def both(
    scene: str, rig: Rig, target: float, times: float, most: int, depth: int | None, folder: Path
) -> Iterator[dict[str, Any]]:
    """A line for each view of a scene."""
    plan = plan_transport(scene, rig=rig, max_depth=depth, measure=False)
    done = render_set(scene, rig, folder / "set", target_error=target, plan=plan)
    samples = min(round(times * max(view["spp"] for view in done.meta["views"].values())), most)
    deep = replace(plan, max_depth=max(LONGEST * plan.max_depth, DEEPEST))
    truth: MultiviewSet = render_set(scene, rig, folder / "truth", spp=samples, plan=deep, seed=1)
    for i, (name, view) in enumerate(done.meta["views"].items()):
        found = measured(
            done.radiance(i).astype(float), truth.radiance(i).astype(float), noise_square(truth.path, name)
        )
        stated = [view["error"], *view["error_by_brightness"]]
        yield {
            "scene": scene, "view": name, "spp": view["spp"], "reference_spp": samples, "max_depth": plan.max_depth,
            "stated": stated, "measured": found, "ratio": [s / m for s, m in zip(stated, found, strict=True)],
        }  # fmt: skip


def main() -> None:
    """Write a JSON line for each view, then the smallest and the largest ratio of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--target-error", type=float, default=0.05)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--times", type=float, default=16, help="samples of the reference, in samples of the set")
    parser.add_argument("--most", type=int, default=65536, help="samples per pixel of the reference at most")
    parser.add_argument("--max-depth", type=int, help="cut paths there by hand")
    parser.add_argument("--out", type=Path, help="file for the JSON lines beside stdout")
    a = parser.parse_args()
    ratios = []
    for scene in a.scenes:
        with tempfile.TemporaryDirectory() as folder:
            rig = default_rig(scene, a.views, a.size, a.size)
            for line in both(scene, rig, a.target_error, a.times, a.most, a.max_depth, Path(folder)):
                ratios.append(line["ratio"])
                print(text := json.dumps(line), flush=True)
                if a.out:
                    with a.out.open("a", encoding="utf-8") as file:
                        file.write(text + "\n")
    found = np.array(ratios)
    outside = f"{(found < 1).sum()} below the measured error, {(found > 1.5).sum()} above 1.5 times it"
    print(f"{found.size} figures: {outside}; smallest {found.min():.2f}, largest {found.max():.2f}")


if __name__ == "__main__":
    main()
