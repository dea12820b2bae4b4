r"""Equal error against plain Mitsuba, and how well times are predicted. The knobs' curves: `novags pareto render`.

    python scripts/bench_render.py --equal-size 96 --equal-views 8 --target-error 0.03 [--out FILE]
    python scripts/bench_render.py --scene hall --equal-size 64 --equal-views 3 --target-error 0.05 --depths 4 8 16 \
        --peers independent stratified multijitter orthogonal ldsampler --plain-spp 64 --plain-seeds 3
    python scripts/bench_render.py --equal-views 0 --predict tabletop gallery street
    python scripts/bench_render.py --scene busts --equal-size 256 --target-error 0.05 --starts 2 3 5
    python scripts/bench_render.py --equal-size 64 --equal-views 3 --target-error 0.05 --fresh hall tabletop
    python scripts/bench_render.py --equal-size 96 --denoise tabletop cornell courtyard

Writes JSON lines {"knob", "setting", "seconds", "error", "error_unit", "error_sd", "default"}, knob "method", that
compare whole jobs: `render_set` to a target error, everything included (reading the scene, planning, predicting,
geometry, writing), and what `mi.render` needs with Mitsuba's samplers (--peers) at several path lengths (--depths),
roulette from 5, for the same error in every view, reading the scene included. All errors are measured: of ours against
a deep render of --reference-spp samples by another seed, whose own variance is subtracted, of the others from the
spread between seeds and from the light that their path length leaves out, which no sample takes away. Their time is
scaled from the time of --plain-spp samples: exactly for independent ones, since their noise falls as one over the root
of the samples; with the others it falls faster, so that they are rendered once more, with about the samples that were
found to be needed, --most at most, and scaled from there (see "needed_spp"). Kernels are compiled beforehand for all.
With --predict: the processor time that `render_set` predicted, and took, once with --plain-spp samples and once towards
the target error, and its peak memory. With --starts, and nothing else: the same job with roulette from each of these
path lengths, twice each, in turn. With --fresh, and nothing else: what `novags render` takes for these scenes in a new
process, stage by stage, on a machine that has never seen the scene, so that every kernel has to be compiled, and once
more when the kernels are kept. With --denoise, and nothing else: error and processor time of views of these scenes with
and without Intel's denoiser, at 16 to 1,024 samples a pixel.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from simscenes import activate, default_rig, plan_transport, render_set
from simscenes.job.curves import DEFAULT, NOISE, SceneBench
from simscenes.loading.load import LoadedScene, build_scene
from simscenes.render.sensors import sensor_dict
from simscenes.rigs import Rig
from simscenes.sets.multiview import MultiviewSet
from simscenes.transport.pilot import DEEPEST
from simscenes.transport.plan import TransportPlan

PEERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
# Times the least time of all, at which a way is not rendered once more with the samples that it needs: its time would
# have to fall by half, which is our guess of what never happens.
HOPELESS = 2


class Clock:
    """Seconds on the wall, and of the processors, which tell more on a machine that others use as well."""

    def __init__(self) -> None:
        self.start = np.array([time.perf_counter(), time.process_time()])

    def read(self) -> NDArray[np.float64]:
        """[wall, processor] since the start."""
        return np.array([time.perf_counter(), time.process_time()]) - self.start


@dataclass(frozen=True)
class Job:
    """What `render_set` did with some views.

    Attributes:
        errors: Relative error of each view, root of the mean square over the repeats.
        seconds: [wall, processor] of the whole job, medians of the repeats.
        fixed: Processor seconds of it before the first view: reading and planning.
    """

    errors: list[float]
    seconds: NDArray[np.float64]
    fixed: float


def ours(scene: str, rig: Rig, target: float, reference_spp: int, repeats: int) -> Job:
    """Time and error of whole jobs, which differ in their seeds alone."""
    with tempfile.TemporaryDirectory() as folder:
        render_set(scene, rig, Path(folder) / "warm", target_error=0.5)
        done: list[MultiviewSet] = []
        spent: list[NDArray[np.float64]] = []
        before: list[float] = []
        for seed in range(repeats):
            clock = Clock()
            begun: list[float] = []

            def first(count: int, total: int, what: str, clock: Clock = clock, begun: list[float] = begun) -> None:
                begun.extend([clock.read()[1]] if not begun and what.startswith("view") else [])

            made = render_set(scene, rig, Path(folder) / f"{seed}", target_error=target, seed=seed, progress=first)
            done.append(made)
            spent.append(clock.read())
            before.append(begun[0])
            print(json.dumps({"stages": made.meta["seconds"], "views": made.meta["views"]}), flush=True)
        plan = TransportPlan.from_dict(done[0].meta["plan"])
        deep = replace(plan, max_depth=max(plan.max_depth, DEEPEST))
        exact = render_set(scene, rig, Path(folder) / "exact", spp=reference_spp, plan=deep, seed=repeats)
        truths = []
        for i in range(len(rig)):
            variance = exact.variance(i)
            assert variance is not None, "a rendered set has variances"
            truths.append((exact.radiance(i).astype(np.float64), float(variance.mean())))
        errors = [
            relative([((made.radiance(i) - truth) ** 2).mean() - noise for made in done], truth)
            for i, (truth, noise) in enumerate(truths)
        ]
        return Job(errors, np.median(spent, axis=0), float(np.median(before)))


def relative(squares: Sequence[float], truth: NDArray[np.float64]) -> float:
    """Root of the mean of squared errors over the mean light, 0 where their noise leaves less than nothing."""
    return math.sqrt(max(float(np.mean(squares)), 0.0)) / float(truth.mean())


@dataclass(frozen=True)
class Peer:
    """Plain renders of all views with one of Mitsuba's samplers: `spp` is what it made of the samples asked for."""

    spp: int
    seconds: NDArray[np.float64]  # [views, 2], wall and processor, of one render: medians of the seeds
    noise: list[float]  # relative, of one render

    def needed(self, wanted: Sequence[float], cut: Sequence[float]) -> tuple[NDArray[np.float64], float]:
        """[wall, processor] seconds and samples a pixel for these errors, `cut` being what its paths leave out."""
        times = [
            (noise**2 / (want**2 - missing**2)) if want > missing else math.inf
            for noise, want, missing in zip(self.noise, wanted, cut, strict=True)
        ]
        return (self.seconds * np.array(times)[:, None]).sum(0), self.spp * float(np.mean(times))


def plain(mi: Any, loaded: LoadedScene, rig: Rig, sampler: str, depth: int, spp: int, seeds: int) -> Peer:
    """Plain renders of all views with `seeds` seeds; kernels are compiled before the clock starts."""
    integrator = mi.load_dict({"type": "path", "max_depth": depth})
    found: list[tuple[NDArray[np.float64], float]] = []
    for i in range(len(rig)):
        settings = sensor_dict(mi, rig, i, loaded) | {"sampler": {"type": sampler, "sample_count": spp}}
        sensor = mi.load_dict(settings)
        spp = int(sensor.sampler().sample_count())  # it may have rounded
        images, seconds = [], []
        for seed in range(seeds + 1):
            clock = Clock()
            image = mi.render(loaded.scene, sensor=sensor, integrator=integrator, spp=spp, seed=1000 * i + seed)
            images.append(np.array(image, dtype=np.float64)[..., :3])
            seconds.append(clock.read())
        noise = float(np.sqrt(np.var(images[1:], 0, ddof=1).mean()) / np.mean(images[1:]))
        found.append((np.median(seconds[1:], axis=0), noise))
    return Peer(spp, np.array([one[0] for one in found]), [one[1] for one in found])


def left_out(mi: Any, loaded: LoadedScene, rig: Rig, depth: int, spp: int, seeds: int) -> list[float]:
    """Relative error of each view that no sample takes away: light of longer paths.

    A deep render of the same seed has the same paths up to this length, so that their noise cancels; the product of two
    seeds' differences is free of the noise of the rest.
    """
    deep, cut = (mi.load_dict({"type": "path", "max_depth": longest}) for longest in (DEEPEST, depth))
    found = []
    for i in range(len(rig)):
        settings = sensor_dict(mi, rig, i, loaded) | {"sampler": {"type": "multijitter", "sample_count": spp}}
        sensor = mi.load_dict(settings)
        whole, short = (
            [
                np.array(mi.render(loaded.scene, sensor=sensor, integrator=way, spp=spp, seed=seed), dtype=np.float64)
                for seed in range(seeds)
            ]
            for way in (deep, cut)
        )
        missing = [(a - b)[..., :3] for a, b in zip(whole, short, strict=True)]
        products = [(a * b).mean() for a, b in itertools.combinations(missing, 2)]
        found.append(relative(products, np.mean(whole, axis=0)[..., :3]))
    return found


def equal_error(
    scene: str, size: int, views: int, target: float, spp: int, most: int, seeds: int,
    reference_spp: int, repeats: int, peers: Sequence[str], depths: Sequence[int],
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """All ways to render the same views to the same errors."""
    rig = default_rig(scene, views, size, size)
    job = ours(scene, rig, target, reference_spp, repeats)
    reached = float(np.sqrt(np.mean(np.square(job.errors))))
    shared = {"knob": "method", "error_unit": NOISE, "error_sd": float(np.std(job.errors))}
    yield {**shared, "setting": "render_set", "seconds": job.seconds[0], "error": reached, "default": True}
    mi, clock = activate(), Clock()
    loaded = build_scene(scene, mi)
    read = clock.read()
    found: dict[tuple[str, int], tuple[Peer, list[float]]] = {}
    for depth in depths:
        cut = left_out(mi, loaded, rig, depth, spp, seeds)
        found |= {(name, depth): (plain(mi, loaded, rig, name, depth, spp, seeds), cut) for name in peers}
    least = min(float(peer.needed(job.errors, cut)[0][1]) for peer, cut in found.values())
    for (sampler, depth), (peer, cut) in found.items():
        needed, samples = peer.needed(job.errors, cut)
        if sampler != "independent" and needed[1] < HOPELESS * least:
            peer = plain(mi, loaded, rig, sampler, depth, round(min(max(samples, 4), most)), seeds)
            needed, samples = peer.needed(job.errors, cut)
        if not math.isfinite(needed[1]):
            needed, samples = np.full(2, np.nan), math.nan  # JSON has no infinity
        needed += read
        setting = f"plain mi.render, {sampler}, depth {depth}"
        yield {**shared, "setting": setting, "seconds": needed[0], "error": reached, "default": False}
        yield {
            "scene": scene, "size": size, "views": views, "sampler": sampler, "depth": depth, "plain_spp": peer.spp,
            "plain_error": float(np.sqrt(np.mean(np.square(peer.noise)))), "left_out": max(cut), "needed_spp": samples,
            "processor_seconds": [job.seconds[1], needed[1]], "fixed_seconds": job.fixed,
            "equal_error_speedup": needed[0] / job.seconds[0], "equal_error_speedup_cpu": needed[1] / job.seconds[1],
        }  # fmt: skip


def predictions(scenes: Sequence[str], size: int, target: float, spp: int) -> Iterator[dict[str, Any]]:
    """Seconds of radiance predicted and spent, for a fixed number of samples and for a target error.

    The processor's clock stands in for the wall's: on a machine that others use as well, the wall's changes its pace
    between the prediction and the job.
    """
    for scene in scenes:
        rig = default_rig(scene, 8, size, size)
        with tempfile.TemporaryDirectory() as folder:
            render_set(scene, rig, folder, target_error=0.5)  # compiles, which no clock of the processor can take out
        for quality in ({"spp": spp}, {"target_error": target}):
            with tempfile.TemporaryDirectory() as folder, patch("time.perf_counter", time.process_time):
                meta = render_set(scene, rig, folder, **quality).meta  # type: ignore[arg-type]  # one of two keywords
            foretold, spent = meta["predicted_seconds"], meta["seconds"]["radiance"]
            yield {
                "scene": scene,
                "size": size,
                **quality,
                "predicted": foretold,
                "radiance": spent,
                "ratio": foretold / spent,
                "peak_bytes": meta["peak_bytes"],
            }


def starts_of_roulette(
    scene: str, size: int, views: int, target: float, starts: Sequence[int], repeats: int = 2
) -> Iterator[dict[str, Any]]:
    """What the whole job takes by where roulette starts, planning included; the first round compiles the kernels."""
    rig = default_rig(scene, views, size, size)
    spent: dict[int, list[list[float]]] = {}
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
    parser.add_argument("--most", type=int, default=1024, help="samples of a plain render: its 32-bit film rounds more")
    parser.add_argument("--plain-seeds", type=int, default=4, help="renders whose spread is the error of plain ones")
    parser.add_argument("--peers", nargs="+", default=["independent", "multijitter"], choices=PEERS)
    parser.add_argument("--depths", nargs="+", type=int, default=[8], help="lengths of plain paths")
    parser.add_argument("--repeats", type=int, default=3, help="whole jobs of ours, whose medians count")
    parser.add_argument("--reference-spp", type=int, default=4096)
    a = parser.parse_args()
    size, views = a.equal_size, a.equal_views
    sampling = (a.plain_spp, a.most, a.plain_seeds, a.reference_spp, a.repeats, a.peers, a.depths)
    compared = equal_error(a.scene, size, views, a.target_error, *sampling) if views else ()
    foretold = predictions(a.predict, a.equal_size, a.target_error, a.plain_spp)
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
