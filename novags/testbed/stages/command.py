"""A method that is a program: a capture in, pictures of the held-out views out, and a run folder made of these."""

import os
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from novags.methods.problem import encode
from novags.testbed.console.terminal import Console
from novags.testbed.folders import run as run_folder
from novags.testbed.folders.capture import RECORD, Capture, open_capture
from novags.testbed.importing.pictures import ForeignPicture, find_renders, read_picture
from novags.testbed.importing.programs import Spent, run_program
from novags.testbed.ledger.stage import run_stage
from novags.testbed.stages.configs.command import CommandConfig
from novags.testbed.stages.paths import keep_apart
from sensor_model.files.atomic import remove, write_text
from sensor_model.files.door import admitted, resolved
from sensor_model.isp import to_linear16
from simscenes.sets.pictures.exr import write_exr
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import CAMERA_FILES

SHOWN = (RECORD, "images", "images16", "raw", *CAMERA_FILES)  # of a capture: all but the truth and lit twins
UNEVEN = ("views of this capture differ in exposure or white balance, and the program gets them as taken: `uneven` of"
          " capture.json has the factors of each view; pictures are scored at the common exposure")  # fmt: skip
WORK = ".work"  # of a run under way: hidden, so that it is part of no digest


def run_command(
    capture_path: Path, out: Path, config: CommandConfig, console: Console, *, overwrite: bool = False
) -> dict[str, Any]:
    """Let a program reconstruct the capture at `capture_path`; returns run.json.

    Raises:
        ValueError: If the capture cannot be read, the program fails or takes too long, its pictures are missing or do
            not show the test views, or `out` holds other things.
        BlockingIOError: If another process is writing to `out`.
    """
    keep_apart(out, capture_path)
    capture = open_capture(capture_path)
    source = capture.source(console)
    return run_stage(
        f"command {config.name}",
        out,
        run_folder.RECORD,
        code=config.code,
        opened={"capture": capture.content, "set": source.content},
        inputs=lambda: {"capture": capture.digest(), "set": source.digest()},
        config=config.resolved(),
        owns=(*run_folder.OWNS, WORK),
        prepare=lambda: None,
        work=lambda _: _reconstruct(capture, out, config, console),
        console=console,
        overwrite=overwrite,
    )


def _reconstruct(capture: Capture, out: Path, config: CommandConfig, console: Console) -> dict[str, Any]:
    """Run the program and write its pictures; returns the body of run.json."""
    work = out / WORK
    remove(work)  # leftovers of a killed attempt
    try:
        shown, made = work / "capture", work / "out"
        show(capture, shown)
        if capture.record.uneven.exposures:
            console.note(f"{config.name}: {UNEVEN}")
        if config.given:
            without_noise(capture, shown)
        made.mkdir()
        words = config.words(capture=str(resolved(shown)), out=str(resolved(made)), seed=str(config.seed))
        console.note(f"{config.name}: {shlex.join(words)}")
        with console.progress(f"command {config.name}") as progress:
            spent = run_program(words, config.folder, timeout=config.timeout,
                                tick=lambda seconds: progress(0, 0, f"{seconds:.0f} s"))  # fmt: skip
        with_depth = _keep_pictures(capture, made, out, config.space)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return _body(capture, out, config, spent, with_depth)


def _keep_pictures(capture: Capture, made: Path, out: Path, space: str) -> bool:
    """Write the program's pictures, of this space, as pictures of a run; returns whether they have depth."""
    rig, cameras = capture.cameras.rig, capture.cameras
    names = [cameras.names[i] for i in cameras.test_indices]
    renders = find_renders(made, names)
    linear = space == "linear"
    pictures = {name: read_picture(renders.files[name], rig.width, rig.height, linear=linear) for name in names}
    for name, picture in pictures.items():
        write_png(out / "renders" / f"{name}.png", encode(picture.values) if linear else picture.values)
        write_exr(out / "exr" / f"{name}.exr", _channels(picture))
    return all(picture.depth is not None for picture in pictures.values())


def _channels(picture: ForeignPicture) -> dict[str, np.ndarray]:
    found = {c: np.ascontiguousarray(picture.values[..., k]) for k, c in enumerate("RGB")}
    if picture.depth is None or picture.alpha is None:
        return found
    return {**found, "Z": np.maximum(picture.depth, 0), "alpha": picture.alpha}


def _body(capture: Capture, out: Path, config: CommandConfig, spent: Spent, with_depth: bool) -> dict[str, Any]:
    write_text(out / run_folder.EVENTS, "")
    return {
        "name": config.name,
        "method": config.name,
        "title": config.title or f"the program {config.command}",
        "variant": {},
        "capture": os.path.relpath(resolved(capture.path), resolved(out)),
        "space": config.space,
        "sees_truth": bool(config.given),
        "enhancement": None,
        "config": {"command": config.command, "timeout": config.timeout, "space": config.space},
        "seed": config.seed,
        "depth": with_depth,
        "seconds": {"command": spent.seconds},
        "peak_bytes": spent.peak_bytes,
    }


def show(capture: Capture, folder: Path) -> None:
    """Lay out the part of a capture that a method may see: copies of its files, so that a program can change none of
    them.

    Through links it could, and other methods would then see its changes; they would lead it to the truth, too.

    The truth is not among it. Dark pictures of the test views are, as every data set of the field has them, and
    test_list.txt names them.
    """
    folder.mkdir(parents=True)
    for name in SHOWN:
        path = capture.path / name
        files = [path] if path.is_file() else sorted(part for part in path.rglob("*") if part.is_file())
        for file in files:
            copy = folder / file.relative_to(capture.path)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(admitted(file), copy)


def without_noise(capture: Capture, folder: Path) -> None:
    """Replace the pictures that are shown in `folder` by the noise-free exposures, developed alike.

    There are no raw files without noise: none are left, and a program that reads them fails.
    """
    for i, name in enumerate(capture.names):
        write_png(folder / "images" / f"{name}.png", capture.clean(i, demosaiced=True))
        if capture.holds("images16"):
            write_png(folder / "images16" / f"{name}.png", to_linear16(capture.clean_linear(i, demosaiced=True)))
    shutil.rmtree(folder / "raw", ignore_errors=True)  # a capture may have none
