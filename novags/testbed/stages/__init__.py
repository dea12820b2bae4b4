"""The stages, folder in, folder out. What makes them resumable and keeps finished work is `cache.run_stage`.

`stale` names files elsewhere that tell of an earlier result; they go when it goes.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from novags.testbed.cache import run_stage
from novags.testbed.console import Console
from novags.testbed.folders import capture as capture_folder
from novags.testbed.folders import run as run_folder
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.run import METRICS, Run, open_run
from novags.testbed.folders.set import Source, open_source
from novags.testbed.metrics import PerceptualDistance
from novags.testbed.stages.capture import CaptureConfig, capture_views, meter
from novags.testbed.stages.reconstruct import ReconstructConfig, method_input, reconstruct_views
from novags.testbed.stages.render import RECORD as RENDER_RECORD
from novags.testbed.stages.render import RenderConfig, prepare_render, render_views, scene_digest, write_layouts
from novags.testbed.stages.score import score_test_views, score_training_images
from simscenes import EXPORTS
from simscenes.job.identity import SPENT
from simscenes.sets.camera_files import CAMERA_FILES


def render(out: Path, config: RenderConfig, console: Console, *, stale: Sequence[Path] = ()) -> dict[str, Any]:
    """Render a scene into the set folder `out`; returns set.json.

    Raises:
        ValueError: If the scene is unknown or cannot be rendered, or `out` holds other things.
    """
    record = run_stage(
        "render",
        out,
        RENDER_RECORD,
        inputs={"scene": scene_digest(config)},
        config=config.resolved(),
        owns=(RENDER_RECORD, "gt", "images", SPENT, *CAMERA_FILES, *EXPORTS),
        prepare=lambda: prepare_render(config, console),
        work=lambda prepared: render_views(out, config, *prepared, console),
        console=console,
        stale=stale,
    )
    write_layouts(out, config.export, console)
    return record


def capture(
    set_path: Path, out: Path, config: CaptureConfig, console: Console, *, stale: Sequence[Path] = ()
) -> dict[str, Any]:
    """Photograph the set at `set_path` in the dark; returns capture.json.

    Raises:
        ValueError: If the set cannot be read or is black, or `out` holds other things.
    """
    _keep_apart(out, set_path)
    source = open_source(set_path, console, config.max_size)
    return run_stage(
        "capture",
        out,
        capture_folder.RECORD,
        inputs={"set": source.digest()},
        config=config.resolved(),
        owns=capture_folder.OWNS,
        prepare=lambda: meter(source, config, console),
        work=lambda light: capture_views(source, light, out, config, console),
        console=console,
        stale=stale,
    )


def reconstruct(
    capture_path: Path, out: Path, config: ReconstructConfig, console: Console, *, stale: Sequence[Path] = ()
) -> dict[str, Any]:
    """Reconstruct the capture at `capture_path` by one method; returns run.json.

    Raises:
        ValueError: If the capture or its set cannot be read, or `out` holds other things.
    """
    _keep_apart(out, capture_path)
    captured = open_capture(capture_path)
    source = captured.source(console)
    return run_stage(
        f"reconstruct {config.method}",
        out,
        run_folder.RECORD,
        inputs={"capture": captured.digest(), "set": source.digest()},
        config=config.resolved(),
        owns=run_folder.OWNS,
        prepare=lambda: method_input(captured, config, console),
        work=lambda inputs: reconstruct_views(captured, inputs, out, config, console),
        console=console,
        stale=stale,
    )


def _keep_apart(out: Path, source: Path) -> None:
    """What is written inside an input would change its hash, and the stage would never count as done."""
    if out.resolve().is_relative_to(source.resolve()):
        raise ValueError(f"the output {out} must not lie inside its input {source}: choose another --out")


def score(run_path: Path, console: Console) -> dict[str, Any]:
    """Score the run at `run_path` against the truth of its capture; returns its metrics.json.

    Raises:
        ValueError: If the run, its capture or its set cannot be read, or the run was not made from them as they are.
    """
    run = open_run(run_path)
    captured, lit = run.inputs(console)
    missing = PerceptualDistance.missing()
    inputs = {"run": run.digest(), "capture": captured.digest(), "set": lit.digest()}

    def work(_: None) -> dict[str, Any]:
        lpips = PerceptualDistance() if missing is None else None
        with console.progress(f"score {run.method}") as progress:
            scores = score_test_views(run, captured, lit, lpips, progress)
        method = {
            **scores,
            "training_2d": score_training_images(run, captured),
            "seconds": stage_seconds(run, captured, lit),
            "peak_bytes": run.record["stage"]["peak_bytes"],
        }
        unavailable = {} if missing is None else {"lpips": missing}
        return {"methods": {run.method: method}, "recovered": {}, "unavailable": unavailable}

    config = {"lpips": missing is None}
    return run_stage(
        "score", run_path, METRICS, inputs=inputs, config=config, owns=(METRICS,), prepare=lambda: None, work=work,
        console=console,
    )  # fmt: skip


def stage_seconds(run: Run, captured: Capture, lit: Source) -> dict[str, float]:
    """Seconds of every stage that led to the run, and of the parts of its reconstruction."""
    rendered = lit.views.meta.get("stage")
    seconds = {} if rendered is None else {"render": float(rendered["seconds"])}
    seconds["capture"] = float(captured.record["stage"]["seconds"])
    seconds["reconstruct"] = float(run.record["stage"]["seconds"])
    return {**seconds, **{f"reconstruct/{part}": float(s) for part, s in run.record["seconds"].items()}}
