"""Results in the JSON layout of nerfbaselines (1.2): one file a method and scene, and one table of all.

results.json                        the table, as `nerfbaselines generate-dataset-results --results` shows it
METHOD/SCENE/results.json           scores of every view, as little-endian float32 in base64, and their checksums
METHOD/SCENE/predictions/           color/ and gt-color/: the 8-bit pictures that the scores compare

Scores are of 8-bit pictures, as there: PSNR, SSIM (11 x 11 Gaussian window), MAE, MSE, LPIPS (AlexNet) where it is
installed. Only `reference` decides on the compared pictures; it is part of the name of the data set.
"""

import base64
import hashlib
import struct
from collections.abc import Collection, Iterator, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Literal

import numpy as np

from novags.testbed.console.provenance import package_version
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.exposures import as_compared, exposures_of
from novags.testbed.folders.references import references
from novags.testbed.folders.run import Run
from novags.testbed.folders.runs import runs_in
from novags.testbed.folders.set import Source
from novags.testbed.ledger.contents import write_json
from novags.testbed.ledger.dry import planned
from novags.testbed.metrics.images import psnr, ssim
from novags.testbed.metrics.perceptual import lpips, missing
from sensor_model.files.atomic import remove
from sensor_model.files.door import read_bytes, resolved
from simscenes.sets.names import safe_name
from simscenes.sets.pictures.png import write_png

OWN = RESULTS, PREDICTIONS = "results.json", "predictions"
DIGITS = 5
METRICS: dict[str, tuple[str, str, bool]] = {  # name, description, whether higher is better
    "psnr": ("PSNR", "Peak signal-to-noise ratio, dB", True),
    "ssim": ("SSIM", "Structural similarity, 11 x 11 Gaussian window, sigma 1.5", True),
    "lpips": ("LPIPS", "Learned perceptual distance, AlexNet", False),
    "mae": ("MAE", "Mean absolute error", False),
    "mse": ("MSE", "Mean squared error", False),
}


def export_results(
    folders: Sequence[Path], out: Path, console: Console, *, reference: Literal["lit", "enhanced"] = "lit",
    dataset: str = "novags", overwrite: bool = False,
) -> Path:  # fmt: skip
    """Write results of runs, of experiments and of studies; returns the table.

    Args:
        folders: Of runs, experiments or studies, or folders that hold runs and experiments.
        out: Where to write.
        console: Where progress goes.
        reference: The reference of pictures: the views in good light, or the enhanced noise-free exposures.
        dataset: Name of the data set.
        overwrite: Replace results that are there.

    Raises:
        ValueError: If no run is found, a run cannot be read or lacks the reference, or `out` already holds results.
    """
    if (out / RESULTS).exists() and not overwrite:
        raise ValueError(f"{out} holds {RESULTS} already: choose another --out, or add --overwrite")
    runs = _named(list(runs_in(folders).values()), reference, console)
    places = [out / safe_name(method) / scene for _, method, scene in runs]
    planned(console, "export-results", [out / RESULTS, *(place / name for place in places for name in OWN)])
    (out / RESULTS).unlink(missing_ok=True)  # an interruption leaves no table that is not of what lies beside it
    identity = dataset if reference == "lit" else f"{dataset}-{reference}"
    table: dict[str, dict[str, Any]] = {}
    with console.progress("export") as progress:
        for done, ((run, method, scene), place) in enumerate(zip(runs, places, strict=True)):
            found = _results_of(run, *run.inputs(console), reference, place)
            write_json(place / RESULTS, _record(run, method, identity, scene, found, place / PREDICTIONS))
            row = table.setdefault(method, {"id": method, "name": method, "description": run.record.get("title", ""),
                                            "scenes": {}})  # fmt: skip
            means = {name: round(float(np.mean(values)), DIGITS) for name, values in found.items()}
            row["scenes"][scene] = {"id": scene, **means, "total_train_time": round(_seconds(run), DIGITS)}
            progress(done + 1, len(runs), f"{method} {scene}")
    write_json(out / RESULTS, _table(table, identity, reference))
    return out / RESULTS


def _named(runs: Sequence[Run], reference: str, console: Console) -> list[tuple[Run, str, str]]:
    """The runs with the names of their methods and of their scenes.

    Raises:
        ValueError: If one cannot be read, or lacks the reference.
    """
    named: list[tuple[Run, str, str]] = []
    contents: dict[str, str] = {}  # of captures, by the name of their scene
    for run in runs:
        capture, lit = run.inputs(console)
        known = references(run, capture, lit, capture.cameras.test_indices[0])
        if reference not in known:
            raise ValueError(f"{run.path} has no reference {reference}: it has {', '.join(known) or 'none'}")
        scene = next(name for name in scene_names(capture) if contents.setdefault(name, capture.content)
                     == capture.content)  # fmt: skip
        named.append((run, _method_of(run, {method for _, method, where in named if where == scene}), scene))
    return named


def scene_names(capture: Capture) -> Iterator[str]:
    """The values that tell a capture from others: scene, camera, light, seed; where that is not enough, size, or its
    content.
    """
    record = capture.record
    parts = [capture.path.name if record.scene is None else record.scene, record.sensor_name or "camera"]
    if (told := record.simulated) is not None:
        parts += [f"{told.electrons:g}e", f"s{told.seed}"]
    yield safe_name("-".join(parts))
    yield safe_name("-".join([*parts, f"{record.views}x{record.width}x{record.height}"]))
    yield safe_name("-".join([*parts, capture.content[:12]]))


def _method_of(run: Run, taken: Collection[str]) -> str:
    """The method of a run; where other runs of it show the same scene, with as much of its folder as differs."""
    parts = resolved(run.path).parts[1:]
    names = (run.name, *(f"{run.name}@{safe_name('_'.join(parts[-k:]))}" for k in range(1, len(parts) + 1)))
    return next(name for name in names if name not in taken)


def _results_of(run: Run, capture: Capture, lit: Source, reference: str, place: Path) -> dict[str, list[float]]:
    """Scores of every held-out view; writes the pictures that they compare."""
    remove(place / PREDICTIONS)
    found: dict[str, list[float]] = {}
    indices = capture.cameras.test_indices
    exposures = exposures_of(run, capture, lit) if run.space == "linear" else None
    rig = capture.cameras.rig
    perceptual = missing(rig.width, rig.height) is None
    for i in indices:
        known = references(run, capture, lit, i)
        rendered = run.rendering(capture.names[i])
        pictures = {
            "color": as_compared(rendered, run, capture, reference, exposures), "gt-color": known[reference],
        }  # fmt: skip
        codes = {kind: np.round(np.clip(image, 0, 1) * 255).astype(np.uint8) for kind, image in pictures.items()}
        for kind, picture in codes.items():
            write_png(place / PREDICTIONS / kind / f"{capture.names[i]}.png", picture)
        for name, value in scores(codes["color"], codes["gt-color"], perceptual).items():
            found.setdefault(name, []).append(value)
    return found


def scores(picture: np.ndarray, truth: np.ndarray, perceptual: bool) -> dict[str, float]:
    """Scores of 8-bit pictures [h,w,3]; `perceptual`: LPIPS too."""
    a, b = (codes.astype(np.float32) / np.float32(255) for codes in (picture, truth))
    error = a.astype(np.float64) - b
    found = {
        "psnr": psnr(a, b),
        "ssim": ssim(a, b),
        "mae": float(np.abs(error).mean()),
        "mse": float((error**2).mean()),
    }
    return {**found, "lpips": lpips(a, b)} if perceptual else found


def _record(
    run: Run, method: str, dataset: str, scene: str, found: dict[str, list[float]], pictures: Path
) -> dict[str, Any]:
    now = datetime.now(timezone.utc).replace(tzinfo=None).isoformat(timespec="seconds")
    version = f"novags {package_version('novags')}"
    about = {"id": dataset, "scene": scene, "type": "object-centric", "color_space": "srgb",
             "evaluation_protocol": "default"}  # fmt: skip
    return {
        "render_datetime": now, "render_version": version, "render_dataset_metadata": about,
        "nb_info": {
            "method": method, "nb_version": version, "num_iterations": None,
            "total_train_time": round(_seconds(run), DIGITS),
            "resources_utilization": {"memory": round(_memory(run) / 2**20)},
            "datetime": now, "config_overrides": {}, "applied_presets": [], "dataset_metadata": about,
            "evaluation_protocol": "default", "hparams": run.record["config"],
        },
        "evaluate_datetime": now, "evaluate_version": version,
        "metrics": {name: round(float(np.mean(values)), DIGITS) for name, values in found.items()},
        "metrics_raw": {name: encoded(values) for name, values in found.items()},
        "metrics_sha256": checksum(found),
        "predictions_sha256": _files_checksum(pictures / "color"),
        "ground_truth_sha256": _files_checksum(pictures / "gt-color"),
        "evaluation_protocol": "default",
    }  # fmt: skip


def _seconds(run: Run) -> float:
    return float(run.record["stage"]["seconds"])


def _memory(run: Run) -> int:
    return run.peak_bytes


def encoded(values: Sequence[float]) -> str:
    """Numbers as base64 of little-endian float32."""
    return base64.b64encode(struct.pack(f"<{len(values)}f", *values)).decode("ascii")


def checksum(found: dict[str, list[float]]) -> str:
    """SHA-256 over the scores: of each, by name, its name and the sorted values."""
    total = hashlib.sha256()
    for name in sorted(found):
        total.update(name.lower().encode())
        total.update(encoded(sorted(found[name])).encode("ascii") + b"\n")
    return total.hexdigest()


def _files_checksum(folder: Path) -> str:
    total = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        total.update(read_bytes(path))
    return total.hexdigest()


def _table(rows: dict[str, dict[str, Any]], dataset: str, reference: str) -> dict[str, Any]:
    """All methods and scenes; a method that has every scene has means over them too."""
    scenes = list(dict.fromkeys(scene for row in rows.values() for scene in row["scenes"]))
    names = [name for name in METRICS if any(name in s for row in rows.values() for s in row["scenes"].values())]
    for row in rows.values():
        row["scenes"] = {scene: row["scenes"][scene] for scene in scenes if scene in row["scenes"]}
        if len(row["scenes"]) == len(scenes):
            for name in (*names, "total_train_time"):
                row[name] = round(float(np.mean([scores[name] for scores in row["scenes"].values()])), DIGITS)
    metrics = [{"id": name, "name": METRICS[name][0], "description": METRICS[name][1], "ascending": METRICS[name][2],
                "link": ""} for name in names]  # fmt: skip
    what = "the views in good light" if reference == "lit" else "the noise-free exposures, enhanced as each method does"
    return {
        "id": dataset, "name": dataset, "description": f"Dark captures of known scenes, compared with {what}",
        "paper_title": "", "paper_authors": [], "paper_link": "", "link": "", "default_metric": "psnr",
        "metrics": metrics, "scenes": [{"id": scene, "name": scene} for scene in scenes],
        "methods": list(rows.values()),
    }  # fmt: skip
