"""A whole training run: seconds, where they go, memory and PSNR. Run by `bench_splats.py fit`."""

import cProfile
import dataclasses
import math
import pstats
import resource
import sys
import time
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from novags.splats import FitConfig, Gaussians, Views, fit, rasterize

# parts of an iteration: the chains and kernels of novags/splats/cpu that Python calls
PARTS = {
    "activate": "exp, sigmoid", "project_and_list": "projection, colours, depth order, first tile lists",
    "composite_wave": "compositing, further tile lists", "compare": "L1 + SSIM",
    "composite_backward": "compositing backward", "step": "projection and colours backward, Adam",
    "add": "Langevin noise",
}  # fmt: skip


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
    from novags.methods.enhancers import enhanced_clean
    from novags.methods.enhancers.guided import EnhanceConfig
    from novags.methods.start import start_gaussians
    from novags.testbed.console import Console
    from novags.testbed.folders.capture import open_capture
    from novags.testbed.stages.reconstruct import ReconstructConfig, prepare

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
    """Milliseconds of CPU per iteration of each part on one thread, at the full number of Gaussians and SH degree 3."""
    torch.set_num_threads(1)
    config = FitConfig(iterations=iterations, sh_every=1)
    fit(start, views, lambda i: images[i], dataclasses.replace(config, iterations=5))
    profiler = cProfile.Profile(time.thread_time)
    profiler.enable()
    fit(start, views, lambda i: images[i], config)
    profiler.disable()
    parts = dict.fromkeys([*PARTS.values(), "rest (torch, Python)"], 0.0)
    for (file, _, function), (_, _, seconds, _, _) in pstats.Stats(profiler).stats.items():  # type: ignore[attr-defined]
        compiled = Path(file).parent.name in ("chains", "cpu") and function in PARTS
        parts[PARTS[function] if compiled else list(parts)[-1]] += 1e3 * seconds / iterations
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
        "cpu_ms_per_iteration": profile(result.gaussians, views, images, 200) if device == "cpu" else None,
    }  # fmt: skip
