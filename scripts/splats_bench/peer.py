"""Whole iterations of OpenSplat's CPU path beside ours, in one run. Run by `bench_splats.py peer`.

OpenSplat is run as a program that the user has built; a difference of two runs takes its loading away.
"""

import json
import resource
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from novags.splats.gaussians import Gaussians
from novags.splats.training.config import FitConfig
from novags.splats.training.fit import fit
from novags.splats.views import Views
from simscenes.sets.pictures.png import write_png

SHORT, LONG = 20, 120  # iterations of either program


def measure_peer(program: Path, problem: tuple[Gaussians, Views, Tensor], degree: int, rounds: int) -> dict[str, Any]:
    """Processor milliseconds of an iteration from the same pictures, cameras and points; the least of the rounds."""
    start, views, images = problem
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        _write_project(Path(folder), start, views, images)
        options = ["--cpu", "-o", f"{folder}/splat.ply", "--sh-degree", str(degree), "--sh-degree-interval", "1"]
        options += ["--num-downscales", "0", "--refine-every", "1000000", "--reset-alpha-every", "1000000"]
        command = [str(program), folder, *options, "-n"]
        theirs = min(_per_iteration(lambda n: _seconds([*command, str(n)])) for _ in range(rounds))
    k = (degree + 1) ** 2
    sh = torch.zeros(len(start), k, 3)
    sh[:, : min(k, start.sh.shape[1])] = start.sh[:, :k]
    start = Gaussians(**{**start.tensors(), "sh": sh})

    def train(iterations: int) -> float:
        config = FitConfig(iterations=iterations, sh_degree=degree, sh_every=1, cap_max=len(start))
        began = time.process_time()
        fit(start, views, lambda i: images[i], config)
        return time.process_time() - began

    train(SHORT)  # compiles
    ours = min(_per_iteration(train) for _ in range(rounds))
    torch.set_num_threads(threads)
    return {"gaussians": len(start), "size": [views.width, views.height], "degree": degree, "ours_ms": 1e3 * ours,
            "opensplat_ms": 1e3 * theirs, "ratio": theirs / ours}  # fmt: skip


def measure_trainer(program: Path, n: int, size: int, ours: float) -> dict[str, Any]:
    """The image-fitting workload of OpenSplat's `simple_trainer`, beside our seconds for it."""
    command = [str(program), "--cpu", "--points", str(n), "--width", str(size), "--height", str(size), "--iters"]
    theirs = _per_iteration(lambda count: _seconds([*command, str(count)]), 2, 12)
    return {"gaussians": n, "size": [size, size], "ours_ms": 1e3 * ours, "opensplat_ms": 1e3 * theirs,
            "ratio": theirs / ours}  # fmt: skip


def _per_iteration(run: Callable[[int], float], short: int = SHORT, long: int = LONG) -> float:
    return (run(long) - run(short)) / (long - short)


def _seconds(command: Sequence[str]) -> float:
    """Processor seconds of a program on one thread."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          env={"OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"})  # fmt: skip
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed: {done.stdout[-500:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _write_project(folder: Path, start: Gaussians, views: Views, images: Tensor) -> None:
    """Pictures, cameras and points as nerfstudio has them."""
    (folder / "images").mkdir()
    frames = []
    for k, (viewmat, K, image) in enumerate(zip(views.viewmats, views.Ks, images, strict=True)):
        write_png(folder / "images" / f"{k:04d}.png", image.clamp(0, 1).numpy())
        to_world = torch.linalg.inv(viewmat.double()) @ torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0])).double()
        frames.append({
            "file_path": f"images/{k:04d}.png", "transform_matrix": to_world.tolist(), "fl_x": float(K[0, 0]),
            "fl_y": float(K[1, 1]), "cx": float(K[0, 2]), "cy": float(K[1, 2]), "w": views.width, "h": views.height,
        })  # fmt: skip
    said = {"camera_model": "OPENCV", "ply_file_path": "points.ply", "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(said), encoding="utf-8")
    colors = ((start.sh[:, 0] * 0.28209479177387814 + 0.5).clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    rows = np.zeros(len(start), [(c, "<f4") for c in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")])
    for k, c in enumerate("xyz"):
        rows[c] = start.means[:, k].numpy()
    for k, c in enumerate(("red", "green", "blue")):
        rows[c] = colors[:, k]
    head = [f"element vertex {len(start)}", *(f"property float {c}" for c in "xyz")]
    head += [f"property uchar {c}" for c in ("red", "green", "blue")]
    text = "\n".join(["ply", "format binary_little_endian 1.0", *head, "end_header", ""])
    (folder / "points.ply").write_bytes(text.encode() + rows.tobytes())
