"""Equal error against plain Mitsuba, and how well times are predicted. The knobs' curves: `novags pareto render`.

    python scripts/bench_render.py --equal-size 96 --equal-views 8 --target-error 0.03 [--out FILE]
    python scripts/bench_render.py --equal-views 0 --predict tabletop gallery street
    python scripts/bench_render.py --scene busts --equal-size 256 --target-error 0.05 --starts 2 3 5
    python scripts/bench_render.py --equal-size 64 --equal-views 3 --target-error 0.05 --fresh hall tabletop
    python scripts/bench_render.py --equal-size 96 --denoise tabletop cornell courtyard

Writes JSON lines {"knob", "setting", "seconds", "error", "error_unit", "error_sd", "default"}, knob "method", that
compare whole jobs: `render_set` to a target error, everything included (reading the scene, planning, predicting,
geometry, writing), and what `mi.render` needs with an independent and with a multijittered sampler, depth 8 and
roulette from 5, for the same error in every view, reading the scene included. All errors are measured: of ours against
a render of --reference-spp samples by another seed, whose own variance is subtracted, of the others from the spread
between seeds. Their time is scaled from the time of --plain-spp samples: exactly, since their noise falls as one over
the root of the samples; the noise of multijittered ones falls faster, so that they are rendered once more, with about
the samples that were found to be needed, and scaled from there (see "needed_spp"). Kernels are compiled beforehand for
all. With --predict: the time that `render_set` predicted, and the time it took, once with a number of samples and once
towards the target error. With --starts, and nothing else: the same job with roulette from each of these path lengths,
twice each, in turn. With --fresh, and nothing else: what `novags render` takes for these scenes in a new process, stage
by stage, on a machine that has never seen the scene, so that every kernel has to be compiled, and once more when the
kernels are kept. With --denoise, and nothing else: error and processor time of views of these scenes with and without
Intel's denoiser, at 16 to 1,024 samples a pixel.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes import activate, default_rig, plan_transport, render_set
from simscenes.job.curves import DEFAULT, NOISE, SceneBench
from simscenes.loading.load import build_scene
from simscenes.render.radiance import grid_spp
from simscenes.render.sensors import sensor_dict
from simscenes.rigs import Rig
from simscenes.transport.plan import TransportPlan

PLAIN = {"type": "path", "max_depth": 8}
PEERS = ("independent", "multijitter")
MOST_SPP = 1024  # of a plain render; beyond that, its 32-bit film rounds


class Clock:
    """Seconds on the wall, and of the processors, which tell more on a machine that others use as well."""

    def __init__(self) -> None:
        self.start = np.array([time.perf_counter(), time.process_time()])

    def read(self) -> NDArray[np.float64]:
        """[wall, processor] since the start."""
        return np.array([time.perf_counter(), time.process_time()]) - self.start


def ours(scene: str, rig: Rig, target: float, reference_spp: int) -> tuple[list[float], NDArray[np.float64]]:
    """Relative errors of the views of a set against long renders, and the seconds of the whole job."""
    with tempfile.TemporaryDirectory() as folder:
        render_set(scene, rig, Path(folder) / "warm", target_error=0.5)
        clock = Clock()
        done = render_set(scene, rig, Path(folder) / "set", target_error=target)
        spent = clock.read()
        print(json.dumps({"stages": done.meta["seconds"], "views": done.meta["views"]}), flush=True)
        plan = TransportPlan.from_dict(done.meta["plan"])
        exact = render_set(scene, rig, Path(folder) / "exact", spp=reference_spp, plan=plan, seed=1)
        errors = []
        for i in range(len(rig)):
            truth, variance = exact.radiance(i).astype(np.float64), exact.variance(i)
            assert variance is not None, "a rendered set has variances"
            square = ((done.radiance(i) - truth) ** 2).mean() - variance.mean()
            errors.append(float(np.sqrt(max(square, 0.0)) / truth.mean()))
        return errors, spent


def plain(
    scene: str, rig: Rig, errors: list[float], spp: int, sampler: str, seeds: int
) -> tuple[NDArray[np.float64], float, float]:
    """Seconds that plain rendering needs for these errors, its relative error at `spp`, and the samples it needs."""
    mi = activate()
    clock = Clock()
    loaded = build_scene(scene, mi)
    needed, integrator, found, samples = clock.read(), mi.load_dict(PLAIN), [], []
    for i, wanted in enumerate(errors):
        settings = sensor_dict(mi, rig, i, loaded) | {"sampler": {"type": sampler, "sample_count": spp}}
        sensor = mi.load_dict(settings)
        np.array(mi.render(loaded.scene, sensor=sensor, integrator=integrator, spp=spp, seed=99))
        images, clock = [], Clock()
        for seed in range(seeds):
            image = mi.render(loaded.scene, sensor=sensor, integrator=integrator, spp=spp, seed=1000 * i + seed)
            images.append(np.array(image, dtype=np.float64)[..., :3])
        seconds = clock.read() / seeds
        found.append(float(np.sqrt(np.var(images, 0, ddof=1).mean()) / np.mean(images)))
        samples.append(spp * (found[-1] / wanted) ** 2)
        needed += seconds * samples[-1] / spp
    return needed, float(np.sqrt(np.mean(np.square(found)))), float(np.mean(samples))


def equal_error(
    scene: str, size: int, views: int, target: float, spp: int, seeds: int, reference_spp: int, peers: Sequence[str]
) -> Iterator[dict[str, Any]]:
    """All ways to render the same views to the same errors."""
    rig = default_rig(scene, views, size, size)
    errors, seconds = ours(scene, rig, target, reference_spp)
    reached = float(np.sqrt(np.mean(np.square(errors))))
    shared = {"knob": "method", "error_unit": NOISE, "error_sd": float(np.std(errors))}
    yield {**shared, "setting": "render_set", "seconds": seconds[0], "error": reached, "default": True}
    for sampler in peers:
        needed, error, samples = plain(scene, rig, errors, spp, sampler, seeds)
        near = spp
        if sampler == "multijitter":
            near = grid_spp(min(max(samples, 4), MOST_SPP))
            needed, error, samples = plain(scene, rig, errors, near, sampler, seeds)
        setting = f"plain mi.render, {sampler}"
        yield {**shared, "setting": setting, "seconds": needed[0], "error": reached, "default": False}
        yield {
            "scene": scene, "size": size, "views": views, "sampler": sampler, "plain_spp": near, "plain_error": error,
            "needed_spp": samples, "processor_seconds": [seconds[1], needed[1]],
            "equal_error_speedup": needed[0] / seconds[0], "equal_error_speedup_cpu": needed[1] / seconds[1],
        }  # fmt: skip


def predictions(scenes: Sequence[str], size: int, target: float) -> Iterator[dict[str, Any]]:
    """Seconds of radiance predicted and spent, for a fixed number of samples and for a target error."""
    for scene in scenes:
        rig = default_rig(scene, 8, size, size)
        for quality in ({"spp": 256}, {"target_error": target}):
            with tempfile.TemporaryDirectory() as folder:
                meta = render_set(scene, rig, folder, **quality).meta  # type: ignore[arg-type]  # one of two keywords
            foretold, spent = meta["predicted_seconds"], meta["seconds"]["radiance"]
            yield {
                "scene": scene,
                "size": size,
                **quality,
                "predicted": foretold,
                "radiance": spent,
                "ratio": foretold / spent,
            }


def starts_of_roulette(
    scene: str, size: int, views: int, target: float, starts: Sequence[int], repeats: int = 2
) -> Iterator[dict[str, Any]]:
    """What the whole job takes by where roulette starts, planning included; the first round compiles the kernels."""
    rig, spent = default_rig(scene, views, size, size), {}
    for turn, start in itertools.product(range(repeats + 1), starts):
        with tempfile.TemporaryDirectory() as folder:
            clock = Clock()
            plan = replace(plan_transport(scene, rig=rig, measure=False), rr_depth=start)
            done = render_set(scene, rig, folder, target_error=target, plan=plan)
            if turn:
                samples = float(np.mean([view["spp"] for view in done.meta["views"].values()]))
                spent.setdefault(start, []).append([*clock.read(), samples])
    for start, found in spent.items():
        seconds, processor, samples = np.mean(found, axis=0)
        yield {
            "scene": scene, "size": size, "views": views, "target_error": target, "rr_depth": start, "seconds": seconds,
            "processor_seconds": processor, "processor_seconds_each": [one[1] for one in found], "spp": samples,
        }  # fmt: skip


def fresh(scenes: Sequence[str], size: int, views: int, target: float) -> Iterator[dict[str, Any]]:
    """Seconds by stage of the command in a new process, with and without kernels that an earlier one compiled."""
    for scene in scenes:
        with tempfile.TemporaryDirectory() as home:  # where Dr.Jit keeps its kernels
            for kernels in ("new", "kept"):
                out = Path(home) / kernels
                command = ["render", scene, "--out", out, "--views", views, "--width", size, "--height", size]
                start = time.perf_counter()
                subprocess.run(
                    [sys.executable, "-m", "novags", *map(str, command), "--target-error", str(target)],
                    env=os.environ | {"HOME": home}, check=True, capture_output=True,
                )  # fmt: skip
                seconds = time.perf_counter() - start
                stages = json.loads((out / "set.json").read_text(encoding="utf-8"))["seconds"]
                yield {
                    "scene": scene, "size": size, "views": views, "target_error": target, "kernels": kernels,
                    "seconds": seconds, "stages": stages, "planning_share": stages["plan"] / seconds,
                }  # fmt: skip


def smoothings(scenes: Sequence[str], size: int, seeds: int = 2) -> Iterator[dict[str, Any]]:
    """Relative RMSE and processor seconds of a view at several samples a pixel, as rendered and denoised."""
    for scene in scenes:
        bench = SceneBench(scene, size)
        for spp, denoise in itertools.product((16, 64, 256, 1024), (False, True)):
            found = [bench.noise(replace(DEFAULT, spp=spp, denoise=denoise), seed) for seed in range(seeds)]
            errors = [f.error for f in found]
            yield {
                "knob": "denoise", "setting": denoise, "scene": scene, "spp": spp,
                "cpu_seconds": float(np.median([f.cpu_seconds for f in found])), "error_unit": NOISE,
                "error": float(np.mean(errors)), "error_sd": float(np.std(errors, ddof=1)),
            }  # fmt: skip


def main() -> None:
    """Run the comparisons and write the lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="file for the JSON lines beside stdout")
    parser.add_argument("--scene", default="tabletop")
    parser.add_argument("--equal-size", type=int, default=96, help="width and height where whole jobs are compared")
    parser.add_argument("--equal-views", type=int, default=8, help="0 leaves the comparison out")
    parser.add_argument("--target-error", type=float, default=0.03)
    parser.add_argument("--predict", nargs="*", default=[], help="scenes whose predicted times are checked")
    parser.add_argument("--starts", nargs="*", type=int, default=[], help="path lengths from which roulette starts")
    parser.add_argument("--fresh", nargs="*", default=[], help="scenes that are rendered in processes of their own")
    parser.add_argument("--denoise", nargs="*", default=[], help="scenes whose views are denoised")
    parser.add_argument("--plain-spp", type=int, default=256)
    parser.add_argument("--plain-seeds", type=int, default=4, help="renders whose spread is the error of plain ones")
    parser.add_argument("--peers", nargs="+", default=list(PEERS), choices=PEERS)
    parser.add_argument("--reference-spp", type=int, default=4096)
    a = parser.parse_args()
    size, views = a.equal_size, a.equal_views
    sampling = (a.plain_spp, a.plain_seeds, a.reference_spp, a.peers)
    compared = equal_error(a.scene, size, views, a.target_error, *sampling) if views else ()
    foretold = predictions(a.predict, a.equal_size, a.target_error)
    begun = starts_of_roulette(a.scene, size, views, a.target_error, a.starts)
    alone = fresh(a.fresh, size, views, a.target_error)
    lines = []
    smooth = smoothings(a.denoise, size)
    for line in (
        (a.starts and begun) or (a.fresh and alone) or (a.denoise and smooth) or itertools.chain(compared, foretold)
    ):
        lines.append(json.dumps(line))
        print(lines[-1], flush=True)
    if a.out:
        a.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
