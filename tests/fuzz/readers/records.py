"""JSON records: what the stages write, and people edit."""

from __future__ import annotations

import contextlib
import json
import shutil
from pathlib import Path

import numpy as np

from tests.fuzz.case import Reader
from tests.fuzz.readers.text import some_rig

SIZE = (24, 32)
HARDWARE = {"processor": "x", "cores": 2, "memory_bytes": 10**9, "gpu": None}
STAGE = {
    "key": "k",
    "config": {},
    "seconds": 2.0,
    "peak_bytes": 10**8,
    "versions": {"numpy": "2"},
    "hardware": HARDWARE,
}
CAMERAS = {"source": "known", "unregistered": [], "registered_share": 1.0, "mean_rotation_deg": 0.0,
           "mean_centre_error": 0.0, "depth_scale": 1.0}  # fmt: skip


def make_set(folder: Path, views: int = 3) -> None:
    """A rendered set, without rendering."""
    from simscenes.sets.pictures.exr import write_exr
    from simscenes.sets.pictures.png import write_png
    from simscenes.sets.writers.camera_files import write_cameras

    rng = np.random.default_rng(0)
    names = [f"{i:04d}" for i in range(views)]
    spaces = [f"{n}.{c}" for n in ("N", "Ng") for c in "XYZ"] + [f"{n}.{c}" for n in ("var", "albedo") for c in "RGB"]
    for name in names:
        planes = {c: rng.random(SIZE, np.float32) for c in ("R", "G", "B", "Z", "distance", *spaces)}
        write_exr(
            folder / "gt" / f"{name}.exr",
            {**planes, "id": np.ones(SIZE, np.uint32), "material": np.ones(SIZE, np.uint32)},
        )
        write_png(folder / "images" / f"{name}.png", rng.integers(0, 255, (*SIZE, 3), np.uint8))
    write_cameras(folder, names, some_rig(views, SIZE[1], SIZE[0]))
    facts = {
        "kind": "rendered", "exposure_scale": 1.5, "camera_matrix": [[0.7, 0.2, 0.1], [0.1, 0.8, 0.1], [0.1, 0.2, 0.7]],
        "digest": "ab" * 32, "views": {n: {"spp": 4, "relative_error": 0.1, "fireflies": 0} for n in names},
        "stage": {**STAGE, "inputs": {"scene": "cornell"}},
        "seconds": {"load": 0.1}, "shapes": ["a"], "materials": ["m"], "n_views": views, "width": SIZE[1],
        "height": SIZE[0],
    }  # fmt: skip
    (folder / "set.json").write_text(json.dumps(facts))
    (folder / "seconds.json").write_text(json.dumps({"digest": "ab" * 32, "seconds": {"load": 0.5}}))


def read_set(folder: Path, file: Path) -> object:
    """As capture and render do."""
    from novags.testbed.console.terminal import Console
    from novags.testbed.folders.set import open_source
    from simscenes.job.identity import is_complete, seconds_spent

    complete, spent = is_complete(folder, "ab" * 32, ["0000"]), seconds_spent(folder, "ab" * 32)
    source = open_source(folder, Console(quiet=True), 28)
    return complete, spent, source.radiance(0), source.lit(0), source.digest(), source.color_matrix


def make_capture(folder: Path, views: int = 3, electrons: float = 200.0) -> None:
    from novags.testbed.console.terminal import Console
    from novags.testbed.stages import capture
    from novags.testbed.stages.configs.capturing import CaptureConfig

    (folder / "set").mkdir()
    make_set(folder / "set", views)
    capture(folder / "set", folder / "capture", CaptureConfig(electrons=electrons), Console(quiet=True))


def read_capture(folder: Path, file: Path) -> object:
    from novags.testbed.console.terminal import Console
    from novags.testbed.folders.capture import open_capture

    capture = open_capture(folder / "capture")
    capture.source(Console(quiet=True))
    return capture.clean(0), capture.linear16(0), capture.record.exposure, capture.channels_share


def make_run(folder: Path, views: int = 3, electrons: float = 200.0) -> None:
    """An experiment of two runs whose training nobody did."""
    from novags.testbed.folders.capture import open_capture
    from simscenes.sets.pictures.exr import write_exr
    from simscenes.sets.pictures.png import write_png

    make_capture(folder, views, electrons)
    capture = open_capture(folder / "capture")
    inputs = {"capture": capture.content, "set": capture.record.simulated.set_content}
    rng = np.random.default_rng(0)
    config = {"enhance": {"radius": 8}, "fit": {"iterations": 10}}
    scores = {k: 20.0 for k in ("psnr", "aligned_psnr", "tone_aligned_psnr", "ssim", "aligned_ssim", "flip", "delta_e")}
    methods = {}
    for name in ("naive", "oracle"):
        run = folder / name
        for view in capture.names:
            write_png(run / "renders" / f"{view}.png", rng.integers(0, 255, (*SIZE, 3), np.uint8))
            planes = {c: rng.random(SIZE, np.float32) for c in ("R", "G", "B", "Z", "alpha")}
            write_exr(run / "exr" / f"{view}.exr", planes)
        record = {
            "name": name, "method": name, "capture": "../capture", "space": "enhanced", "config": config,
            "enhancement": {"enhancer": "guided", "pictures": "8bit", "config": config["enhance"]},
            "seconds": {"fit": 1.0}, "cameras": {**CAMERAS, "registered": list(capture.names)},
            "stage": {**STAGE, "inputs": inputs, "config": config},
        }  # fmt: skip
        (run / "run.json").write_text(json.dumps(record))
        (run / "events.jsonl").write_text(
            "".join(json.dumps({"iteration": i, "l1": 0.5 / (i + 1)}) + "\n" for i in range(4))
        )
        mean = {kind: dict(scores) for kind in ("enhanced", "lit")}
        methods[name] = {
            "mean": mean, "views": {"0000": mean}, "geometry": None, "training_2d": None, "cameras": record["cameras"],
            "seconds": {"render": 1.0, "capture": 1.0, "reconstruct": 2.0}, "peak_bytes": 10**8,
        }  # fmt: skip
        (run / "metrics.json").write_text(
            json.dumps({"methods": {name: methods[name]}, "unavailable": {"lpips": "not installed"}})
        )
    rows = [{"run": run, "method": name, "state": "done", "folder": name} for run, name in enumerate(methods, 1)]
    (folder / "results.json").write_text(json.dumps({"axes": {"method": list(methods)}, "rows": rows}))
    (folder / "experiment.json").write_text(json.dumps({"command": "novags run", "preset": {}}))


def read_experiment(folder: Path, file: Path) -> object:
    """As score and report do before they compute."""
    from novags.testbed.console.terminal import Console
    from novags.testbed.report.place import command_of, places_in
    from novags.testbed.stages.scores.scoring import stage_seconds
    from novags.testbed.study.results import rescored

    quiet = Console(quiet=True)
    (place,) = places_in([folder], quiet)
    rescored(folder)
    found = []
    for run in place.runs.values():
        found.append(
            (run.events(), run.rendering("0000"), run.depth("0000"), run.depth_scale, run.enhancement, run.space)
        )
        found.append((stage_seconds(run, *run.inputs(quiet)), place.metrics))
    return found, command_of(folder)


def make_viewed(folder: Path) -> None:
    """A run with the cameras that the viewer aligns."""
    from novags.testbed.folders.capture import open_capture
    from novags.testbed.stages.camera_source import viewer_cameras, views_of

    make_run(folder)
    rig = open_capture(folder / "capture").cameras.rig
    views = [views_of(rig, [i]) for i in range(3)]
    (folder / "naive" / "cameras.json").write_text(json.dumps(viewer_cameras(["0000", "0001", "0002"], views)))


def read_viewed(folder: Path, file: Path) -> object:
    """As the viewer does."""
    from novags.testbed.console.terminal import Console
    from novags.testbed.viewer.shown import shown_of
    from novags.testbed.viewer.world import true_from

    (shown,) = shown_of([folder / "naive"], Console(quiet=True))
    found = true_from(shown.runs["naive"], shown.capture)
    if not (found.scale > 0 and bool(found.rotation.isfinite().all()) and bool(found.translation.isfinite().all())):
        raise AssertionError(f"the run is placed at {found}")
    return found


def read_unfinished(folder: Path, file: Path) -> None:
    from novags.testbed.console.terminal import Console
    from novags.testbed.ledger.code import Code
    from novags.testbed.ledger.stage import run_stage

    class Started(Exception):
        """Instead of work, which would change the folder."""

    def prepare() -> None:
        raise Started

    with contextlib.suppress(Started):
        run_stage(
            "score", folder, "metrics.json", code=Code({}, {}), inputs=dict, config={}, owns=("metrics.json",),
            prepare=prepare, work=lambda _: {}, console=Console(quiet=True), overwrite=True,
        )  # fmt: skip


def make_unfinished(folder: Path) -> None:
    (folder / "unfinished.json").write_text(json.dumps({"stage": "score", "key": "k", "seconds": 1.5}))
    (folder / "metrics.json").write_text(json.dumps({"methods": {}, "stage": {"key": "k", "seconds": 3.0}}))


def make_log(folder: Path) -> None:
    """The losses of a run that was stopped."""
    lines = [json.dumps({"step": i, "stage": "fit", "l1": 0.5 / (i + 1)}) + "\n" for i in range(0, 60, 10)]
    (folder / "events.jsonl").write_text("".join(lines))


def read_log(folder: Path, file: Path) -> None:
    """As a run does that goes on, and one that has nothing left to do."""
    from novags.testbed.folders.events import EventLog

    log = folder / "resumed.jsonl"
    shutil.copyfile(file, log)
    with EventLog(log) as events:
        events.add({"step": 40, "l1": 0.1})
    with EventLog(log):
        pass
    if json.loads(log.read_text().splitlines()[-1]) != {"step": 40, "l1": 0.1}:
        raise AssertionError("the step of the resumed run is not the last one")


def _line() -> None:
    import cv2
    import torch

    import novags.testbed.report.page
    import novags.testbed.stages  # noqa: F401

    torch.set_num_threads(1)
    cv2.setNumThreads(0)


RUN = (
    "naive/run.json",
    "naive/metrics.json",
    "naive/events.jsonl",
    "experiment.json",
    "results.json",
    "capture/capture.json",
)
READERS = [
    Reader("set.json", make_set, read_set, ("set.json", "seconds.json"), share=3, prepare=_line),
    Reader("capture.json", make_capture, read_capture, ("capture/capture.json",), share=1, prepare=_line),
    Reader("records of runs", make_run, read_experiment, RUN, share=0.5, prepare=_line),
    Reader("cameras.json", make_viewed, read_viewed, ("naive/cameras.json",), share=1, prepare=_line),
    Reader("events.jsonl", make_log, read_log, ("events.jsonl",), share=4, prepare=_line, placed=False),
    Reader(
        "unfinished.json", make_unfinished, read_unfinished, ("unfinished.json", "metrics.json"), share=8, prepare=_line
    ),
]
