"""Reconstruct: a capture in, a run out. Reads the pictures, lets a method work on arrays, writes its results."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from novags.cameras.estimate import CameraEstimate
from novags.methods import METHODS, title_of
from novags.methods.inputs import LacksInput
from novags.methods.memo import Memo
from novags.methods.problem import Problem, RawPictures, TrueSurface, stacked
from novags.methods.reconstruction import Reconstruction
from novags.methods.variant import parts_of, sees_statistics
from novags.methods.variant.several import train_several
from novags.splats.views import Views
from novags.testbed.console.devices import chosen_device
from novags.testbed.console.memory import available_bytes
from novags.testbed.console.terminal import Console, losses_text, warnings_as_notes
from novags.testbed.folders import run as run_folder
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.events import EventLog
from novags.testbed.folders.imported import MISSING
from novags.testbed.folders.place import keep_place, recorded_place
from novags.testbed.folders.references import pictured
from novags.testbed.folders.run import CAMERAS, CHECKPOINTS, EVENTS
from novags.testbed.folders.set import Source
from novags.testbed.ledger.stage import run_stage
from novags.testbed.stages.camera_source import CoordinateFrame, cameras_of, true_cameras, viewer_cameras, views_of
from novags.testbed.stages.configs.reconstructing import ReconstructConfig, files_of
from novags.testbed.stages.explaining.given import GIVEN
from novags.testbed.stages.paths import keep_apart
from novags.warm import compile_ahead, kernels_of
from sensor_model.files.lock import locked
from sensor_model.files.reading import some
from simscenes.sets.pictures.exr import write_exr
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import write_json


@dataclass(frozen=True)
class PreparedProblem:
    """A problem, and how its cameras relate to the true ones."""

    problem: Problem
    estimate: CameraEstimate
    indices: list[int]  # of the capture's views, the training views that have a camera
    device: torch.device
    capture: Capture  # whose views are trained on


def reconstruct(
    capture_path: Path,
    out: Path,
    config: ReconstructConfig,
    console: Console,
    *,
    stale: Sequence[Path] = (),
    overwrite: bool = False,
) -> dict[str, Any]:
    """Reconstruct the capture at `capture_path` by one method; returns run.json.

    Raises:
        ValueError: If the capture or its set cannot be read, or `out` holds other things or, unless `overwrite`, a
            finished result of another request.
        BlockingIOError: If another process is writing to `out`.
    """
    keep_apart(out, capture_path)
    capture = open_capture(capture_path)
    if config.hold_out:
        capture = holding_out(capture, config.hold_out, config.seed)
    source = capture.source(console)
    learned = capture if config.more is None else open_capture(config.more)
    of = source if config.more is None else learned.source(console)
    more = (lambda: {}) if config.more is None else lambda: {"more": learned.digest()}
    record = run_stage(
        f"reconstruct {config.variant.name}",
        out,
        run_folder.RECORD,
        code=config.code.along_with((*source.modules, *capture.modules)),
        opened={"capture": capture.content, "set": source.content, **more(), **files_of(config)},
        inputs=lambda: {"capture": capture.digest(), "set": source.digest(), **more(), **files_of(config)},
        config=config.resolved(),
        owns=run_folder.OWNS,
        prepare=lambda: prepare(learned, of, config, console),
        work=lambda prepared: reconstruct_views(capture, prepared, out, config, console),
        console=console,
        stale=stale,
        scrap=CHECKPOINTS,
        overwrite=overwrite,
    )
    with locked(out):
        keep_place(out, record["capture"], capture.path)
    return record


def holding_out(capture: Capture, views: int, seed: int) -> Capture:
    """The capture with so many of its training views, drawn by a seed, among those that nothing is trained on.

    Raises:
        ValueError: If fewer than two training views would be left.
    """
    train = capture.cameras.train_indices
    if len(train) < views + 2:
        raise ValueError(f"hold_out must leave 2 training views, got {views} of {len(train)} in {capture.path}")
    held = sorted(np.random.default_rng([seed, 0x401D]).choice(train, views, replace=False).tolist())
    cameras = replace(capture.cameras, held_out=tuple(sorted([*capture.cameras.test_indices, *held])))
    return replace(capture, cameras=cameras, held=tuple(held), memo=Memo())  # what it keeps is of all training views


def prepare(capture: Capture, source: Source, config: ReconstructConfig, console: Console) -> PreparedProblem:
    """The problem: pictures and cameras of the training views. Truth goes only to methods whose row says so.

    Raises:
        LacksInput: If the method needs the noise-free exposures or the true surface, and they are not known.
        ValueError: If the capture has too few views, the camera source fails, or a file cannot be read.
    """
    method = METHODS[config.variant.method]
    if method.sees_clean and not capture.holds("truth"):
        raise LacksInput(
            f"{config.variant.name} learns from noise-free exposures, and of {capture.path} {MISSING['truth']}"
        )
    wanted = capture.cameras.train_indices
    if len(wanted) < 2:
        raise ValueError(f"{capture.path} has {len(wanted)} training view(s), at least 2 are needed")
    device = chosen_device(config.device, console)
    if device.type == "cpu":
        said_memory(config, len(wanted), capture, console)
    estimate = cameras_of(config.cameras, capture, source, wanted, config.points, config.seed, device, console)
    indices = [wanted[k] for k in estimate.registered]
    if len(indices) < len(wanted):
        lost = [capture.names[i] for i in wanted if i not in indices]
        console.note(f"{len(lost)} of {len(wanted)} training views have no camera and are left out: {', '.join(lost)}")
    made_of = ", ".join(f"{count} {what}" for what, count in estimate.made_of.items())
    console.note(f"{len(estimate.points)} first points of {config.points} asked for: {made_of}")
    problem = Problem(
        views=views_of(estimate.rig),
        start=estimate,
        seed=config.seed,
        srgb8=partial(stacked, capture.srgb8, indices),
        linear16=partial(stacked, capture.linear16, indices) if capture.holds("images16") else None,
        raw=raw_pictures(capture, indices) if capture.holds("raw") else None,
        noise=capture.noise,
        exposures=tuple(capture.record.uneven.times(i) for i in indices),
        channels_share=capture.channels_share,
        pixels_share=capture.pixels_share,
        clean=stacked(capture.clean, indices) if method.sees_clean else None,
        clean_demosaiced=(
            stacked(partial(capture.clean, demosaiced=True), indices)
            if method.sees_clean and capture.demosaiced
            else None
        ),
        surface=partial(true_surface, capture, source, indices, config.variant.name) if method.sees_surface else None,
        lit_mean=lit_mean(source, indices) if sees_statistics(config.config) else None,
        n_gaussians=config.points,
        names=tuple(capture.names[i] for i in indices),
        shared=capture.memo,
    )
    if config.given:
        problem = GIVEN[config.given](problem, capture, source, estimate, indices)
    return PreparedProblem(problem.to(device), estimate, indices, device, capture)


def said_memory(config: ReconstructConfig, views: int, capture: Capture, console: Console) -> None:
    """Say how much main memory the run will take at its peak, and whether that is more than there is."""
    rig, name = capture.cameras.rig, config.variant.name
    needed = METHODS[config.variant.method].memory(config.config, views, rig.width * rig.height, config.points)
    free = available_bytes()
    console.note(f"reconstruct {name}: memory {needed / 1e9:.1f} GB at the peak, {free / 1e9:.1f} GB are free")
    if needed > free:
        console.warn(f"reconstruct {name} is expected to need more memory than is free: take fewer views, smaller "
                     "pictures or fewer points, or end other programs")  # fmt: skip


def lit_mean(source: Source, indices: list[int]) -> float | None:
    """Mean luminance of the well-lit pictures of some views, sRGB code; None where they are not known."""
    found = [float((source.lit(i) @ np.array([0.299, 0.587, 0.114])).mean()) for i in indices if source.shows(i)]
    return float(np.mean(found)) if found else None


def true_surface(capture: Capture, source: Source, indices: list[int], name: str) -> TrueSurface:
    """The surface that all views see, in the frame of the true cameras.

    Raises:
        LacksInput: If it is not known.
    """
    found = (None if source.scaled else source.views.geometry(i) for i in range(len(capture.names)))
    known = [(geometry["z"], geometry["geometric_normals"]) for geometry in found if geometry is not None]
    if len(known) < len(capture.names):
        raise LacksInput(f"{name} follows the true surface, and of {capture.path} it is not known: it was made from "
                         "photographs, or from a set that was scaled down")  # fmt: skip
    return TrueSurface(
        viewmats=true_cameras(capture).numpy(), Ks=np.array(capture.cameras.rig.Ks, np.float64),
        depth=np.stack([depth for depth, _ in known]), normals=np.stack([normals for _, normals in known]),
        training=tuple(indices),
    )  # fmt: skip


def raw_pictures(capture: Capture, indices: list[int]) -> RawPictures:
    """The raw frames of these views, in one exposure."""
    cfa, black, white = capture.levels
    balance, matrix = capture.color
    return RawPictures(
        dn=partial(stacked, capture.even_raw, indices), cfa=cfa, black=black, white=white, balance=balance,
        matrix=matrix,
    )  # fmt: skip


def reconstruct_views(
    capture: Capture, prepared: PreparedProblem, folder: Path, config: ReconstructConfig, console: Console
) -> dict[str, Any]:
    """Train the method on the problem and write everything but the record.

    Returns:
        The body of run.json.

    Raises:
        ValueError: If the method refuses its input.
    """
    variant, problem = config.variant, prepared.problem
    method = METHODS[variant.method]
    parts = parts_of(method, config.config, 1)
    if parts is not None and parts.get("fit") == 0:
        console.note(f"reconstruct {variant.name}: 0 iterations of the fit: the first Gaussians (of NeRF: the first "
                     "field) untrained")  # fmt: skip
    for part, steps in (parts or {}).items():
        if 0 < steps < method.least.get(part, 0):
            console.note(f"reconstruct {variant.name}: {steps} steps of {part} are too few to work, of at least "
                         f"{method.least[part]}: it loses by that alone")  # fmt: skip
    if prepared.device.type == "cpu" and (kernels := kernels_of(config.config)) is not None:
        compile_ahead(kernels, console.note)
    with (
        warnings_as_notes(console),
        console.progress(f"reconstruct {variant.name}", parts_of(method, config.config, variant.fits)) as progress,
        EventLog(folder / EVENTS) as log,
    ):

        def step(done: int, total: int, losses: dict[str, float]) -> None:
            log.add({"step": done, **losses})
            progress(done, total, losses_text(losses))

        train = method.train if variant.fits == 1 else partial(train_several, method, fits=variant.fits)
        result = train(problem, config.config, progress=step, checkpoint=folder / CHECKPOINTS[0])
    frame = CoordinateFrame.of(prepared.capture, prepared.indices, prepared.estimate, result.viewmats)
    facts = frame.facts()
    with console.progress(f"render {variant.name}") as progress:
        own = prepared.capture is capture
        if own:  # pictures of other views would be taken for those of the capture that have their names
            write_images(folder, problem.names, result)
        result.save(folder)
        mine = [frame.view(i, torch.device("cpu")) for i in prepared.indices]
        write_json(folder / CAMERAS, viewer_cameras(problem.names, mine))
        if not own:
            frame = replace(frame, capture=capture, indices=[])
        for i, name in enumerate(capture.names):
            write_rendering(folder, capture, i, result, frame.view(i, prepared.device))
            progress(i + 1, len(capture.names), f"view {name}")
        for at, scene in result.along.items():
            for i in capture.cameras.test_indices:
                then = replace(result, scene=scene)
                write_rendering(run_folder.place_along(folder, at), capture, i, then, frame.view(i, prepared.device))
    if lost := [str(at) for at in asked_along(config.config) if at not in result.along]:
        console.note(
            f"reconstruct {variant.name}: not shown after {some(lost)} iterations: a fit is shown along its own "
            "length, and where nothing but Gaussians is trained"
        )
    return {
        "name": variant.name,
        "method": variant.method,
        "title": title_of(variant.method, variant.title),
        "variant": dict(variant.settings),
        "sees_truth": method.sees_clean or method.sees_surface or bool(config.given) or config.more is not None,
        "capture": recorded_place(folder, capture.path),
        **({"effects": sorted(capture.sensor.effects)} if capture.sensor and capture.sensor.effects else {}),
        "space": result.space,
        "enhancement": result.enhancement,
        **({"found": result.found} if result.found else {}),
        "config": asdict(result.config),
        "seed": config.seed,
        "points": config.points,
        "start": {"points": len(problem.start.points), "made_of": prepared.estimate.made_of},
        "device": str(prepared.device),
        "cameras": {"source": config.resolved()["cameras"], **facts},
        **result.scene.facts(),
        "training_views": len(problem.views),
        **({run_folder.ALONG: sorted(result.along)} if result.along else {}),
        **({run_folder.HELD: [capture.names[i] for i in capture.held]} if capture.held else {}),
        "seconds": result.seconds,
    }


def asked_along(config: Any) -> tuple[int, ...]:
    """The iterations after which a method with this configuration is to be shown; none where it has no fit."""
    return tuple(getattr(getattr(config, "fit", None), "keep_at", ()))


def write_images(folder: Path, names: Sequence[str], result: Reconstruction) -> None:
    """Write the enhanced training images and, if they differ, the targets of the fit."""
    if result.enhanced is not None:
        for name, image in zip(names, result.enhanced, strict=True):
            write_png(folder / "enhanced" / f"{name}.png", image.cpu().numpy())
    if result.targets is not None and (result.enhanced is None or not torch.equal(result.enhanced, result.targets)):
        for name, image in zip(names, result.targets, strict=True):
            write_png(folder / "denoised" / f"{name}.png", image.cpu().numpy())


def write_rendering(folder: Path, capture: Capture, i: int, result: Reconstruction, view: Views) -> None:
    """Render one view; write its picture, and colours, depth and alpha as floats."""
    image, alpha, depth = (tensor[0].cpu().numpy().astype(np.float32) for tensor in result.render(view))
    name, held_out = capture.names[i], i in capture.cameras.test_indices
    picture = pictured(result, capture, image)
    folder.mkdir(parents=True, exist_ok=True)
    write_png(folder / ("renders" if held_out else "renders_train") / f"{name}.png", picture)
    (folder / "exr").mkdir(exist_ok=True)
    colours = {c: np.ascontiguousarray(image[..., k]) for k, c in enumerate("RGB")}
    write_exr(folder / "exr" / f"{name}.exr", {**colours, "Z": depth, "alpha": alpha})
