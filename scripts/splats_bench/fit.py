"""A whole training run: seconds, where they go, memory and PSNR. Run by `bench_splats.py fit`."""

import itertools
import math
import resource
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor

from novags.splats.cpu import parallel
from novags.splats.gaussians import Gaussians
from novags.splats.raster.rasterize import rasterize
from novags.splats.training.config import FitConfig
from novags.splats.training.fit import fit
from novags.splats.views import Views

# parts of an iteration: the chains and kernels of novags/splats/cpu that Python calls
PARTS = {
    "activate": "exp, sigmoid", "project_and_list": "projection, colours, depth order, first tile lists",
    "composite_wave": "compositing, further tile lists", "compare": "L1 + SSIM",
    "composite_backward": "compositing backward", "step": "projection and colours backward, Adam",
    "add": "Langevin noise",
}  # fmt: skip
REST = "rest (torch, Python)"


def random_cloud(n: int, size: int, n_views: int) -> tuple[Gaussians, Views, Tensor]:
    """A grey start of n Gaussians, a ring of cameras, and images of a coloured shell of n splats."""
    g = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(n, 3, generator=g), dim=1)
    points = directions * (0.6 + 0.4 * torch.rand(n, 1, generator=g))
    truth = Gaussians.from_points(points, (torch.sin(9 * points) + 1) / 2, sh_degree=0, init_opacity=0.8)
    viewmats = torch.eye(4).repeat(n_views, 1, 1)
    for k in range(n_views):
        c, s = math.cos(2 * math.pi * k / n_views), math.sin(2 * math.pi * k / n_views)
        viewmats[k, :3, :3] = torch.tensor([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        viewmats[k, 2, 3] = 3.0
    K = torch.tensor([[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1]])
    views = Views(viewmats, K.repeat(n_views, 1, 1), size, size)
    start = Gaussians.from_points(points + 0.01 * torch.randn(n, 3, generator=g), torch.full((n, 3), 0.5), sh_degree=0)
    return start, views, render(truth, views)


def oracle_problem(capture: Path, n: int) -> tuple[Gaussians, Views, Tensor]:
    """What the `oracle` method fits to: the noise-free dark exposures of a capture folder, enhanced."""
    from novags.methods import chosen
    from novags.methods.enhancers.applying import enhanced_clean
    from novags.methods.enhancers.choice import EnhanceConfig
    from novags.methods.start import start_gaussians
    from novags.testbed.console.terminal import Console
    from novags.testbed.folders.capture import open_capture
    from novags.testbed.stages.configs.reconstructing import ReconstructConfig
    from novags.testbed.stages.reconstructing import prepare

    console, opened = Console(quiet=True), open_capture(capture)
    config = ReconstructConfig(variant=chosen("oracle"), points=n, device="cpu")
    problem = prepare(opened, opened.source(console), config, console).problem
    images = enhanced_clean(problem, EnhanceConfig(), "8bit")
    start = start_gaussians(problem.start, problem.srgb8, images, sh_degree=3, init_scale=0.7)
    return start, problem.views, images


def render(gaussians: Gaussians, views: Views) -> Tensor:
    """All views [C, H, W, 3]."""
    g = gaussians
    with torch.no_grad():
        return torch.cat(
            [
                rasterize(
                    g.means, g.quats, g.scales, g.opacities, g.sh, viewmat[None], K[None], views.width, views.height,
                    sh_degree=g.sh_degree,
                )[0]
                for viewmat, K in zip(views.viewmats, views.Ks, strict=True)
            ]
        )  # fmt: skip


def profile(start: Gaussians, views: Views, images: Tensor, iterations: int) -> dict[str, float]:
    """Milliseconds of each part on one thread at SH degree 3: medians over the iterations."""
    torch.set_num_threads(1)
    began: list[float] = []
    spent: list[Counter[str]] = []

    def image(index: int) -> Tensor:
        began.append(time.perf_counter())
        spent.append(Counter())
        return images[index]

    def timed(call: Callable[..., None]) -> Callable[..., None]:
        def run(kernel: Any, *arguments: Any) -> None:
            start = time.perf_counter()
            call(kernel, *arguments)
            if spent:
                spent[-1][PARTS[kernel.__name__]] += 1e3 * (time.perf_counter() - start)

        return run

    with ExitStack() as stack:
        for module in [module for name, module in sys.modules.items() if name.startswith("novags.splats")]:
            for name in ("run", "run_chain"):
                if getattr(module, name, None) is getattr(parallel, name) and module is not parallel:
                    stack.enter_context(patch.object(module, name, timed(getattr(parallel, name))))
        fit(start, views, image, FitConfig(iterations=iterations, sh_every=1))
    whole = [1e3 * (after - before) for before, after in itertools.pairwise(began)]
    parts = {part: statistics.median(times[part] for times in spent) for part in PARTS.values()}
    parts[REST] = statistics.median(all_ - times.total() for all_, times in zip(whole, spent, strict=False))
    return dict(sorted(parts.items(), key=lambda item: -item[1]))


def measure_fit(
    iterations: int, n: int, size: int, n_views: int, capture: str | None = None, device: str = "cpu"
) -> dict[str, Any]:
    """Train, then look at where the time of an iteration goes."""
    problem = random_cloud(n, size, n_views) if capture is None else oracle_problem(Path(capture), n)
    start, views, images = problem[0], problem[1], problem[2].to(device)
    start = Gaussians(**{name: tensor.to(device) for name, tensor in start.tensors().items()})
    views = Views(views.viewmats.to(device), views.Ks.to(device), views.width, views.height)
    began, course = time.perf_counter(), []

    def progress(done: int, total: int, entry: dict[str, float]) -> None:
        if done % 500 == 0:
            row = {"iteration": done, "seconds": time.perf_counter() - began, "n_gaussians": int(entry["n_gaussians"])}
            course.append(row)
            print(row, file=sys.stderr, flush=True)

    cpu = time.process_time()
    result = fit(start, views, lambda i: images[i], FitConfig(iterations=iterations, cap_max=n), progress=progress)
    cpu = time.process_time() - cpu
    mse = float((render(result.gaussians, views) - images).square().mean())
    return {
        "seconds": result.seconds, "cpu_seconds": cpu, "psnr": -10 * math.log10(mse),
        "size": [views.width, views.height],
        "views": len(views), "gaussians": len(result.gaussians), "iterations": iterations, "course": course,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "ms_per_iteration": profile(result.gaussians, views, images, 200) if device == "cpu" else None,
    }  # fmt: skip
