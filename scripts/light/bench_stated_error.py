"""Does the error that a render states hold? Stated and measured error of every view, whole and by brightness.

    python scripts/light/bench_stated_error.py tabletop cornell hall --out build/stated.jsonl
    python scripts/light/bench_stated_error.py hall cornell --max-depth 3
    python scripts/light/bench_stated_error.py street:0.4 one-pixel-sun:0.1 --size 32

Each scene is rendered to --target-error, or to its own behind a colon, and once more with other seeds, --times the
samples of its largest view, and paths four times as long. The error of a pixel is the difference between the two; its
mean square, less the noise of the second render, is the square of the measured error, and nan where nothing is left.
Pixels are sorted by the light of the first render, as `error_by_brightness` sorts them. `one-pixel-sun` is not in the
catalogue: a glass ball on a floor under a sky with a sun of one pixel, 22,000 times as bright, whose light behind the
ball few paths find.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes import activate, default_rig, orbit_rig, plan_transport, render_set
from simscenes.loading.reference import SceneLike
from simscenes.rigs import Rig
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.exr import read_exr
from simscenes.transport.pilot import DEEPEST

SUN = "one-pixel-sun"
LONGEST = 4  # times the path length of the plan, in the reference


def one_pixel_sun() -> dict[str, Any]:
    """A glass ball on a floor under a sky of 64 x 32 pixels, one of which is the sun; world z is up."""
    import mitsuba as mi

    sky = np.full((32, 64, 3), 1.0, dtype=np.float32)
    sky[8, 20] = 22000.0
    up = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    floor = mi.ScalarTransform4f().translate([0, 0, -0.5]).scale(3)
    return {
        "type": "scene",
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky), "to_world": up},
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": grey},
        "ball": {"type": "sphere", "radius": 0.5, "bsdf": {"type": "dielectric"}},
    }


def views_of(scene: str, views: int, size: int) -> tuple[SceneLike, Rig]:
    """A scene of the catalogue or of this script, and its cameras."""
    if scene != SUN:
        return scene, default_rig(scene, views, size, size)
    activate()
    return one_pixel_sun(), orbit_rig(views, size, size, 50, radius=3, elevation_deg=25)


def noise_square(folder: Path, name: str) -> NDArray[np.float64]:
    """Square of the noise of each pixel and channel, from the two halves of its samples, [h,w,3]."""
    channels, _ = read_exr(folder / "gt" / f"{name}.exr")
    return np.square(np.stack([channels[f"half.{c}"] for c in "RGB"], -1, dtype=np.float64))


def measured(light: NDArray[np.float64], truth: NDArray[np.float64], noise: NDArray[np.float64]) -> list[float]:
    """Relative RMSE of a view [h,w,3] and of its quarters, darkest first; `noise` is the square of the truth's own."""
    square, level = (np.square(light - truth) - noise).mean(-1).ravel(), light.mean(-1).ravel()
    order = np.argsort(level, kind="stable")
    return [
        math.sqrt(rest) / float(level[chosen].mean()) if (rest := float(square[chosen].mean())) > 0 else math.nan
        for chosen in (order, *np.array_split(order, 4))
    ]


def both(
    name: str, scene: SceneLike, rig: Rig, target: float, times: float, most: int, depth: int | None, folder: Path
) -> Iterator[dict[str, Any]]:
    """A line for each view of a scene."""
    plan = plan_transport(scene, rig=rig, max_depth=depth, measure=False)
    done = render_set(scene, rig, folder / "set", target_error=target, plan=plan)
    samples = min(round(times * max(view["spp"] for view in done.meta["views"].values())), most)
    deep = replace(plan, max_depth=max(LONGEST * plan.max_depth, DEEPEST))
    truth: MultiviewSet = render_set(scene, rig, folder / "truth", spp=samples, plan=deep, seed=1)
    for i, (number, view) in enumerate(done.meta["views"].items()):
        found = measured(
            done.radiance(i).astype(float), truth.radiance(i).astype(float), noise_square(truth.path, number)
        )
        stated = [view["error"], *view["error_by_brightness"]]
        yield {
            "scene": name, "view": number, "target": target, "spp": view["spp"], "reference_spp": samples,
            "max_depth": plan.max_depth,
            "stated": stated, "measured": found, "ratio": [s / m for s, m in zip(stated, found, strict=True)],
        }  # fmt: skip


def main() -> None:
    """Write a JSON line for each view, then the smallest and the largest ratio of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", help="NAME or NAME:TARGET_ERROR")
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
        name, _, own = scene.partition(":")
        target = float(own) if own else a.target_error
        with tempfile.TemporaryDirectory() as folder:
            made, rig = views_of(name, a.views, a.size)
            for line in both(name, made, rig, target, a.times, a.most, a.max_depth, Path(folder)):
                ratios.append(line["ratio"])
                print(text := json.dumps(line), flush=True)
                if a.out:
                    with a.out.open("a", encoding="utf-8") as file:
                        file.write(text + "\n")
    found = np.array(ratios)
    unseen = f"; {np.isnan(found).sum()} of which the reference is too noisy to see" if np.isnan(found).any() else ""
    outside = f"{(found < 1).sum()} below the measured error, {(found > 1.5).sum()} above 1.5 times it"
    print(f"{found.size} figures: {outside}; smallest {np.nanmin(found):.2f}, largest {np.nanmax(found):.2f}{unseen}")


if __name__ == "__main__":
    main()
