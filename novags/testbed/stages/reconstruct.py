"""Reconstruct: a capture in, a run out. Reads the pictures, lets a method work on arrays, writes what it made."""

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
from torch import Tensor

from novags.cameras.known import known
from novags.methods.nova.trainer import NovaConfig
from novags.methods.problem import MethodInput, MethodResult
from novags.methods.table import method_config, suited, train
from novags.splats import Gaussians, Views, rasterize, write_ply
from novags.testbed.cache import jsonable, write_text
from novags.testbed.console import Console, losses_text
from novags.testbed.folders.capture import Capture, DarkSource
from novags.testbed.folders.png import write_png
from novags.testbed.folders.run import CHECKPOINTS, EVENTS
from simscenes.rigs import Rig
from simscenes.sets.exr import write_exr
from simscenes.sets.multiview import MultiviewSet


@dataclass(frozen=True, kw_only=True)
class ReconstructConfig:
    """How to reconstruct a capture."""

    method: str = "nova"  # a name of METHODS
    source: DarkSource = "8bit"  # which pictures the method sees: 8-bit sRGB, or 16-bit linear
    points: int = 8000  # Gaussians at the start, and at most if `nova.fit.cap_max` is None
    seed: int = 0
    nova: NovaConfig = field(default_factory=NovaConfig)  # enhancement and fit of every method, and what is nova's own

    def __post_init__(self) -> None:
        method_config(self.method, self.nova)
        if self.source not in get_args(DarkSource):
            raise ValueError(f"source must be one of {', '.join(get_args(DarkSource))}, got {self.source!r}")
        if self.points < 4:
            raise ValueError(f"points must be >= 4, got {self.points}")
        if self.seed < 0:
            raise ValueError(f"seed must be >= 0, got {self.seed}")

    def resolved(self) -> dict[str, Any]:
        """What decides the result, without what this method does not look at."""
        shared = {"method": self.method, "source": self.source, "points": self.points, "seed": self.seed}
        return {**shared, "config": asdict(method_config(self.method, self.nova))}


def initial_set(capture: Capture, console: Console) -> MultiviewSet:
    """Where initial points come from: the set, whose depth is known if it was rendered; the capture if sizes differ."""
    source = capture.source(console)
    return capture.cameras if source.scaled else source.views


def reconstruct_views(
    capture: Capture, inputs: MethodInput, folder: Path, config: ReconstructConfig, console: Console
) -> dict[str, Any]:
    """Train the method on the capture's training views, `inputs`, and write everything but the record.

    Returns:
        The body of run.json.

    Raises:
        ValueError: If the method refuses its input.
    """
    nova = suited(config.nova, capture.sensor, color_matrix=capture.record["color_matrix"] is not None)
    if config.method == "nova" and nova != config.nova:
        console.note("the channels of a pixel share their noise here (demosaicing, colour matrix): all are blinded")
    settings = method_config(config.method, nova)
    with console.progress(f"reconstruct {config.method}") as progress, EventLog(folder / EVENTS) as log:

        def step(done: int, total: int, losses: dict[str, float]) -> None:
            log.add({"step": done, **losses})
            progress(done, total, losses_text(losses))

        result = train(config.method, inputs, settings, step, folder / CHECKPOINTS[0])
    with console.progress(f"render {config.method}") as progress:
        write_images(folder, capture, result)
        write_ply(folder / "point_cloud.ply", result.gaussians)
        rig = capture.cameras.rig
        for i, name in enumerate(capture.names):
            render = "renders" if i in capture.cameras.test_indices else "renders_train"
            write_rendering(folder, render, name, result.gaussians, rig_views(rig, [i]))
            progress(i + 1, len(capture.names), f"view {name}")
    for checkpoint in CHECKPOINTS:
        (folder / checkpoint).unlink(missing_ok=True)
    return {
        "method": config.method,
        "capture": os.path.relpath(capture.path.resolve(), folder.resolve()),
        "dark_source": config.source,
        "enhance": asdict(settings.enhance),
        "config": result.config,
        "seed": config.seed,
        "gaussians": len(result.gaussians),
        "training_views": len(inputs.views),
        "seconds": result.seconds,
    }


def method_input(capture: Capture, config: ReconstructConfig, console: Console) -> MethodInput:
    """The training views as arrays. Only the oracle is given the noise-free exposures.

    Raises:
        ValueError: If the capture has too few views, or a file of it or of its set cannot be read.
    """
    indices = capture.cameras.train_indices
    if len(indices) < 2:
        raise ValueError(f"{capture.path} has {len(indices)} training view(s), at least 2 are needed")
    dark = stack([capture.dark(i, config.source) for i in indices])
    clean = stack([capture.clean(i) for i in indices]) if config.method == "oracle" else None
    start = known(initial_set(capture, console), indices, dark, n_points=config.points, seed=config.seed)
    return MethodInput(
        views=rig_views(capture.cameras.rig, indices), dark=dark, clean=clean, init=start, seed=config.seed
    )


def stack(images: list[np.ndarray]) -> Tensor:
    """Images [h,w,3] -> [C,h,w,3] float32."""
    return torch.from_numpy(np.stack(images).astype(np.float32))


def rig_views(rig: Rig, indices: list[int]) -> Views:
    """Some cameras of a rig for the rasteriser."""
    viewmats, Ks = (torch.tensor(matrices[indices], dtype=torch.float32) for matrices in (rig.viewmats, rig.Ks))
    return Views(viewmats, Ks, rig.width, rig.height)


def write_images(folder: Path, capture: Capture, result: MethodResult) -> None:
    """Write the enhanced training images and, if the method aimed at others, what it aimed at."""
    names = [capture.names[i] for i in capture.cameras.train_indices]
    denoises = not torch.equal(result.enhanced, result.targets)
    for name, enhanced, target in zip(names, result.enhanced, result.targets, strict=True):
        write_png(folder / "enhanced" / f"{name}.png", enhanced.cpu().numpy())
        if denoises:
            write_png(folder / "denoised" / f"{name}.png", target.cpu().numpy())


def write_rendering(folder: Path, subfolder: str, name: str, gaussians: Gaussians, view: Views) -> None:
    """Render one view; write its picture and its depth."""
    g = gaussians
    with torch.no_grad():
        image, alpha, _ = rasterize(
            g.means, g.quats, g.scales, g.opacities, g.sh, view.viewmats, view.Ks, view.width, view.height,
            sh_degree=g.sh_degree, render_mode="RGB+ED",
        )  # fmt: skip
    pixels = image[0].cpu().numpy()
    write_png(folder / subfolder / f"{name}.png", pixels[..., :3])
    (folder / "depth").mkdir(exist_ok=True)
    write_exr(folder / "depth" / f"{name}.exr", {"Z": pixels[..., 3], "alpha": alpha[0, ..., 0].cpu().numpy()})


class EventLog:
    """events.jsonl: losses as they come, so that an interrupted run keeps those it had."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        self.events = {event["step"]: event for event in map(json.loads, lines)}

    def __enter__(self) -> "EventLog":
        return self

    def __exit__(self, *_: object) -> None:
        ordered = [json.dumps(jsonable(self.events[step])) for step in sorted(self.events)]
        write_text(self.path, "".join(f"{line}\n" for line in ordered))

    def add(self, event: dict[str, Any]) -> None:
        """Keep one event; a step that is done again after an interruption replaces its first attempt."""
        self.events[event["step"]] = event
