"""Time, memory and accuracy of the CPU splat engine.

    python scripts/bench_splats.py grid    --out DIR    forward, backward, iteration against N and image size; a plot
    python scripts/bench_splats.py common  --out DIR    the image-fitting workload that other engines publish, the
                                                        readable reference on it, and 100,000 small splats at 400²
    python scripts/bench_splats.py memory  --out DIR    bytes per Gaussian, per (Gaussian, tile) pair and per pixel
    python scripts/bench_splats.py loss    --out DIR    L1 + SSIM with gradient, and the same by torch and autograd
    python scripts/bench_splats.py fit     --out DIR    7,000 iterations, 256 x 256, 28 views, 50,000 Gaussians, with
                                                        the time of each part; --capture CAP: the oracle's images

    python scripts/bench_splats.py peer    --out DIR --capture CAP --opensplat BUILD
                                                        whole iterations beside OpenSplat's CPU path, built by the
                                                        user (-DGPU_RUNTIME=CPU, with its simple trainer), in one run

What the engine's approximations cost in accuracy and time: `novags pareto splats`.
Every measurement runs in a process of its own, so that peak memory is its own. Times are the best of several repeats.
"""

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from splats_bench.scenes import best, common_scene

from novags.process import settle
from novags.testbed.study.knobs.splat_engine.scene import cube_scene

SIZES = (128, 256, 512, 1024)
COUNTS = (1_000, 10_000, 100_000, 1_000_000)


def peak_mb() -> float:
    """Largest resident memory of this process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure_grid(n: int, size: int, repeat: int, backend: str = "numba") -> dict[str, Any]:
    """Forward, backward, and a whole training iteration (SH degree 3, L1 + SSIM, Adam, noise)."""
    from novags.splats.gaussians import Gaussians
    from novags.splats.raster.rasterize import rasterize
    from novags.splats.training.config import FitConfig, McmcConfig
    from novags.splats.training.fit import fit
    from novags.splats.views import Views

    scene = cube_scene(n, size)
    camera = (scene["viewmats"], scene["Ks"], size, size)
    inputs = [scene[name].requires_grad_() for name in ("means", "quats", "scales", "opacities", "sh")]
    weights = torch.rand(1, size, size, 3)
    times = {"forward": math.inf, "backward": math.inf}

    def once() -> None:
        start = time.perf_counter()
        image, _, _ = rasterize(*inputs, *camera, sh_degree=3, backend=backend)
        middle = time.perf_counter()
        torch.autograd.grad(image, inputs, weights)
        times["forward"] = min(times["forward"], middle - start)
        times["backward"] = min(times["backward"], time.perf_counter() - middle)

    best(once, repeat)
    gaussians = Gaussians(
        means=scene["means"].detach(), quats=scene["quats"].detach(), log_scales=scene["scales"].detach().log(),
        logit_opacities=torch.logit(scene["opacities"].detach()), sh=scene["sh"].detach(),
    )  # fmt: skip
    views = Views(scene["viewmats"], scene["Ks"], size, size)
    stamps: list[float] = []
    config = FitConfig(
        iterations=max(4, repeat), sh_degree=3, sh_every=1, mcmc=McmcConfig(refine_start=10**9), backend=backend
    )
    fit(gaussians, views, lambda i: weights[0], config, before_step=lambda i: stamps.append(time.perf_counter()))
    steps = [b - a for a, b in zip(stamps[1:], stamps[2:], strict=False)]  # SH degree 3 is reached at the third
    return {**times, "iteration": min(steps), "peak_mb": peak_mb()}


def measure_common(
    n: int, size: int, repeat: int, backend: str = "numba", strip: int | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, Any]:  # fmt: skip
    """Fit a two-colour image: render, MSE, backward, Adam on everything.

    The readable reference keeps every pixel times Gaussian for its gradient; it gets `strip` image rows at a time.
    """
    import numpy as np

    from novags.splats.cpu.parallel import run
    from novags.splats.cpu.training import optimizer
    from novags.splats.raster.rasterize import rasterize

    scene = common_scene(n, size)
    trained = {name: scene[name].requires_grad_() for name in ("means", "quats", "scales", "opacities", "colors")}
    target = torch.ones(size, size, 3)
    target[: size // 2, : size // 2] = torch.tensor([1.0, 0.0, 0.0])
    target[size // 2 :, size // 2 :] = torch.tensor([0.0, 0.0, 1.0])
    moments = {name: (torch.zeros_like(t).numpy(), torch.zeros_like(t).numpy()) for name, t in trained.items()}
    count = 0
    times = {"forward": math.inf, "backward": math.inf, "iteration": math.inf}

    def step() -> None:
        nonlocal count
        count += 1
        numbers = (0.9, 0.999, 1 - 0.9**count, math.sqrt(1 - 0.999**count), 1e-8)
        for name, tensor in trained.items():
            assert tensor.grad is not None
            arrays = (tensor.detach().numpy(), tensor.grad.numpy(), *moments[name])
            flat = (a.reshape(-1) for a in arrays)
            run(optimizer.adam, tensor.numel(), 4096, *flat, np.float32(0.01), *(np.float32(x) for x in numbers))
            tensor.grad = None

    def once() -> None:
        spent = {"forward": 0.0, "backward": 0.0}
        began, rows = clock(), strip or size
        for top in range(0, size, rows):
            start = clock()
            scene["Ks"][:, 1, 2] = size / 2 - top
            image, _, _ = rasterize(
                trained["means"], trained["quats"], trained["scales"].abs(), torch.sigmoid(trained["opacities"]),
                torch.sigmoid(trained["colors"]), scene["viewmats"], scene["Ks"], size, rows, backend=backend,
            )  # fmt: skip
            loss = torch.nn.functional.mse_loss(image[0], target[top : top + rows]) * (rows / size)
            middle = clock()
            loss.backward()
            spent["forward"] += middle - start
            spent["backward"] += clock() - middle
        step()
        spent["iteration"] = clock() - began
        times.update({name: min(times[name], value) for name, value in spent.items()})

    best(once, repeat)
    return {**times, "peak_mb": peak_mb()}


def in_child(what: str, **arguments: Any) -> dict[str, Any]:
    """Run measure_<what>(**arguments) in a new process."""
    command = [sys.executable, __file__, "child", json.dumps({"what": what, **arguments})]
    output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    result: dict[str, Any] = json.loads(output.splitlines()[-1])
    return result


def show(row: dict[str, Any]) -> str:
    """One line of a table."""
    text = [f"{k}={v}" for k, v in row.items() if not isinstance(v, float)]
    text += [
        f"{k} {v:.0f} MB" if k == "peak_mb" else f"{k} {1e3 * v:.2f} ms" for k, v in row.items() if isinstance(v, float)
    ]
    return "  ".join(text)


def run_grid(out: Path, repeat: int, largest: int) -> None:
    """All sizes and counts, and the plot."""
    rows = []
    for n in [n for n in COUNTS if n <= largest]:
        for size in SIZES:
            row = {"n": n, "size": size, **in_child("grid", n=n, size=size, repeat=repeat)}
            print(show(row), flush=True)
            rows.append(row)
    (out / "grid.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 4), sharey=True)
    for axis, what in zip(axes, ("forward", "backward", "iteration"), strict=True):
        for size in SIZES:
            points = [(row["n"], 1e3 * row[what]) for row in rows if row["size"] == size]
            axis.loglog(*zip(*points, strict=True), "o-", label=f"{size}²")
        axis.set(title=what, xlabel="Gaussians")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("milliseconds")
    axes[0].legend()
    figure.savefig(out / "grid.png", dpi=120, bbox_inches="tight")


def run_common(out: Path, repeat: int) -> None:
    """The common workload on our kernels, and once on the readable reference; then many small Gaussians."""
    rows = []
    for n, backend, options in (
        (10_000, "numba", {"repeat": repeat}),
        (100_000, "numba", {"repeat": repeat}),
        (10_000, "torch", {"repeat": 1, "strip": 8}),
    ):
        row = {"n": n, "size": 256, "backend": backend}
        rows.append({**row, **in_child("common", **row, **options)})
        print(show(rows[-1]), flush=True)
    print(f"the reference takes {rows[2]['iteration'] / rows[0]['iteration']:.0f} times as long at N = 10,000")
    small = {"n": 100_000, "size": 400}
    rows.append({**small, "scene": "small", **in_child("grid", **small, repeat=repeat)})
    print(show(rows[-1]), flush=True)
    (out / "common.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


def measure_loss(size: int, repeat: int) -> dict[str, Any]:
    """Processor nanoseconds a value of one loss with its gradient, by our kernels and by torch in the same process."""
    from novags.splats.training.losses import compare, ssim

    image, target = torch.rand(2, size, size, 3, generator=torch.Generator().manual_seed(0))
    x, y = image.numpy(), target.numpy()

    def by_torch() -> None:
        leaf = image.clone().requires_grad_()
        (0.8 * (leaf - target).abs().mean() + 0.2 * (1 - ssim(leaf, target))).backward()

    def nanoseconds(call: Callable[[], object], times: int) -> float:
        fastest = math.inf
        for _ in range(times):
            start = time.process_time_ns()
            call()
            fastest = min(fastest, time.process_time_ns() - start)
        return fastest / image.numel()

    compare(x, y, 0.2)  # compiles
    return {"ns": nanoseconds(lambda: compare(x, y, 0.2), 20 * repeat), "torch_ns": nanoseconds(by_torch, repeat)}


def run_loss(out: Path, repeat: int) -> None:
    """Three sizes."""
    rows = [{"size": size, **in_child("loss", size=size, repeat=repeat)} for size in (160, 400, 800)]
    for row in rows:
        print(f"{row['size']}²: {row['ns']:.2f} ns a value, torch {row['torch_ns'] / row['ns']:.1f} times as long")
    (out / "loss.json").write_text(json.dumps(rows, indent=1))


def measure_peer(capture: str, build: str, n: int, repeat: int) -> dict[str, Any]:
    """The demo's workload, and the two of OpenSplat's own `simple_trainer`."""
    from splats_bench import fit, peer

    torch.set_num_threads(1)
    problem = fit.oracle_problem(Path(capture), n)
    rows = [peer.measure_peer(Path(build) / "opensplat", problem, 1, 3)]
    for count in (10_000, 100_000):
        ours = measure_common(count, 256, repeat, clock=time.process_time)["iteration"]
        rows.append(peer.measure_trainer(Path(build) / "simple_trainer", count, 256, ours))
    return {"rows": rows, "peak_mb": peak_mb()}


def measure_memory() -> dict[str, Any]:
    """All that one forward and backward pass allocates, split by least squares over scenes of different make-up."""
    import numpy as np

    from novags.splats.cpu import memory, pipeline
    from novags.splats.raster.rasterize import rasterize

    total, pairs = 0, 0

    def counting(shape: tuple[int, ...] | int, dtype: Any = np.float32) -> np.ndarray:
        nonlocal total
        array = memory.empty(shape, dtype)
        total += array.nbytes
        return array

    forward, rows, bytes_ = pipeline.forward, [], []
    pipeline.empty = counting  # type: ignore[attr-defined]
    for n, size, width in ((20_000, 64, 1), (40_000, 64, 3), (80_000, 128, 1), (40_000, 256, 4), (20_000, 512, 1)):
        scene, total = cube_scene(n, size), 0
        scene["scales"] *= width
        inputs = [scene[name].requires_grad_() for name in ("means", "quats", "scales", "opacities", "sh")]

        def remember(*arguments: Any) -> Any:
            nonlocal pairs
            result = forward(*arguments)
            pairs = int(result[0].splats.counts.sum())
            return result

        pipeline.forward = remember
        image, _, _ = rasterize(*inputs, scene["viewmats"], scene["Ks"], size, size, sh_degree=3)
        torch.autograd.grad(image.sum(), inputs)
        rows.append([n, pairs, size * size])
        bytes_.append(total)
    parts = np.linalg.lstsq(np.array(rows, float), np.array(bytes_, float), rcond=None)[0]
    return dict(zip(("bytes_per_gaussian", "bytes_per_pair", "bytes_per_pixel"), map(float, parts), strict=True))


def measure_fit(**arguments: Any) -> dict[str, Any]:
    """A whole training run."""
    from splats_bench import fit

    return fit.measure_fit(**arguments)


def run_one(out: Path, what: str, **arguments: Any) -> None:
    """One measurement, as JSON."""
    row = in_child(what, **arguments)
    print(json.dumps(row, indent=1))
    (out / f"{what}.json").write_text(json.dumps(row, indent=1))


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["grid", "common", "memory", "loss", "peer", "fit", "child"])
    parser.add_argument("arguments", nargs="?", help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=Path("bench_splats"))
    parser.add_argument("--repeat", type=int, default=15)
    parser.add_argument("--largest", type=int, default=1_000_000, help="most Gaussians in the grid")
    parser.add_argument("--threads", type=int, default=None)
    fit = (
        ("iterations", "iterations", 7000),
        ("gaussians", "n", 50_000),
        ("size", "size", 256),
        ("views", "n_views", 28),
    )
    for name, key, default in fit:
        parser.add_argument(f"--{name}", dest=key, type=int, default=default, help="of the fit")
    parser.add_argument("--capture", default=None, help="capture folder whose noise-free exposures the fit aims at")
    parser.add_argument("--opensplat", default=None, help="folder of its programs")
    parser.add_argument("--device", default="cpu", help="of the fit; cuda takes gsplat")
    options = parser.parse_args()
    if options.threads is not None:
        os.environ["OMP_NUM_THREADS"] = str(options.threads)  # children inherit it
    if options.part == "child":
        arguments = json.loads(options.arguments)
        print(json.dumps(globals()[f"measure_{arguments.pop('what')}"](**arguments)))
        return
    options.out.mkdir(parents=True, exist_ok=True)
    if options.part == "grid":
        run_grid(options.out, options.repeat, options.largest)
    elif options.part == "common":
        run_common(options.out, options.repeat)
    elif options.part == "loss":
        run_loss(options.out, options.repeat)
    elif options.part == "memory":
        run_one(options.out, "memory")
    elif options.part == "peer":
        arguments = {"capture": options.capture, "build": options.opensplat, "n": options.n, "repeat": options.repeat}
        run_one(options.out, "peer", **arguments)
    else:
        keys = [key for _, key, _ in fit] + ["capture", "device"]
        run_one(options.out, "fit", **{key: getattr(options, key) for key in keys})


if __name__ == "__main__":
    settle()
    main()
