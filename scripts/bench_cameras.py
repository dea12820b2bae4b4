"""How cameras fare in the dark.

    python scripts/bench_cameras.py errors --out DIR
        PSNR of the demo against a rotation error of its cameras, 0 to 4 degrees, with and without refinement
    python scripts/bench_cameras.py light --out DIR [--cameras SOURCE ...]
        poses by sources of cameras at 200 to 1 electrons on four scenes, single exposures and means of eight: shares
        registered, areas under the curve of pair errors, trajectory and depth errors

A SOURCE is spelt as for `novags reconstruct --cameras`: a network needs its own installation and weights. Or it is
`poses`, of `novags poses` with settings as for `sfm`: photographs without a focal length in their headers, of which it
finds lens and cameras. Rows are kept in DIR/light.csv: the same command continues, and another SOURCE comes beside what
is there.
"""

import argparse
import csv
import math
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from PIL import Image

from novags.process import settle

SCENES = ("bookshop", "market", "sofa", "bicycle")  # the settings of `sfm` were chosen on another one
ELECTRONS = (200.0, 50.0, 20.0, 5.0, 2.0, 1.0)
SOURCES = (*(f"sfm{':' * bool(how)}{how}" for how in (
    "", "mapper=global", "pictures=enhanced", "pictures=enhanced,mapper=global", "pictures=denoised",
    "pictures=denoised,mapper=global")), "known:rotation_deg=1,translation=0.01")  # fmt: skip
BURSTS = {1: SOURCES, 8: ("sfm", "sfm:pictures=enhanced")}  # frames of a view -> sources that look at their mean
VIEWS, SIZE, POINTS = 20, 160, 1000
AREAS = (5.0, 30.0)  # degrees
SCORES = ("registered", *(f"{what}_auc{t:g}" for what in ("rotation", "translation") for t in AREAS),
          "trajectory", "depth", "seconds")  # fmt: skip
PLACE = ("scene", "electrons", "burst", "cameras", "seed")


def light(options: argparse.Namespace) -> None:
    """Make missing measurements, print the table."""
    from novags.testbed import stages
    from novags.testbed.console.terminal import Console
    from novags.testbed.folders.capture import open_capture
    from novags.testbed.stages.configs.capturing import CaptureConfig
    from novags.testbed.stages.configs.rendering import RenderConfig

    console, out = Console(quiet=True), options.out
    out.mkdir(parents=True, exist_ok=True)
    rows = read_rows(out / "light.csv")
    bursts = dict.fromkeys(options.bursts, options.cameras) if options.cameras else BURSTS
    for scene in options.scenes:
        drawn = RenderConfig(scene=scene, n_views=VIEWS, width=SIZE, height=SIZE, spp=64, truth_samples=1)
        for electrons in options.electrons:
            for burst, sources in bursts.items():
                places = [(scene, f"{electrons:g}", str(burst), source, str(options.seed)) for source in sources]
                if all(place in rows for place in places):
                    continue
                stages.render(out / scene, drawn, console)
                dark = CaptureConfig(electrons=electrons, burst=burst, seed=options.seed)
                stages.capture(out / scene, folder := out / f"{scene}-{electrons:g}-{burst}", dark, console)
                for place in places:
                    if place not in rows:
                        rows[place] = measured(open_capture(folder), place[3], options.seed)
                        write_rows(out / "light.csv", rows)
                        print(*place, {name: round(value, 3) for name, value in rows[place].items()}, flush=True)
    print(f"\n{table(rows)}\n\n{apart(rows)}")


def measured(capture: Any, cameras: str, seed: int) -> dict[str, float]:
    """What a source finds of all views of a capture, `SCORES`; nan where it finds nothing that could be measured."""
    if cameras.split(":")[0] == "poses":
        return measured_poses(capture, cameras, seed)
    from novags.cameras import parse_cameras
    from novags.cameras.align import align, depth_ratios
    from novags.testbed.console.terminal import Console
    from novags.testbed.stages.camera_source import cameras_of, true_cameras

    console = Console(quiet=True)
    true, source = true_cameras(capture), capture.source(console)
    every, start = list(range(len(true))), time.process_time()
    try:
        found = cameras_of(parse_cameras(cameras), capture, source, every, POINTS, seed, torch.device("cpu"), console)
    except ValueError:  # too few views, which is a measurement too
        return poses(np.zeros((0, 4, 4)), true.numpy(), ()) | {
            "depth": math.nan,
            "seconds": time.process_time() - start,
        }
    seconds, chosen = time.process_time() - start, list(found.registered)
    depths = np.stack([source.views.geometry(i)["z"] for i in chosen])  # a rendered set
    aligned = align(found.viewmats, true[chosen])
    Ks = torch.tensor(np.array(capture.cameras.rig.Ks))[chosen]
    ratios = depth_ratios(found, aligned.similarity, true[chosen], Ks, torch.from_numpy(depths))
    depth = float(np.median(np.abs(ratios - 1))) if len(ratios) else math.nan
    return poses(found.viewmats.numpy(), true.numpy(), found.registered) | {"depth": depth, "seconds": seconds}


def measured_poses(capture: Any, cameras: str, seed: int) -> dict[str, float]:
    """The same of `novags poses` with the settings after the colon; no depth."""
    from novags.testbed.stages.camera_source import true_cameras

    settings = dict(one.split("=") for one in cameras[6:].split(",") if one)
    codes = [np.round(255 * capture.srgb8(i)).astype(np.uint8) for i in range(len(capture.cameras.rig))]
    start = time.process_time()
    found = found_by_poses(codes, true_cameras(capture).numpy(), seed, **settings)
    return found | {"depth": math.nan, "seconds": time.process_time() - start}


def found_by_poses(codes: Sequence[np.ndarray], true: np.ndarray, seed: int, **settings: Any) -> dict[str, float]:
    """Scores of the cameras that `novags poses` finds of pictures [H, W, 3] uint8, against the true ones [C, 4, 4]."""
    from novags.testbed import stages
    from novags.testbed.console.terminal import Console
    from novags.testbed.stages.configs.posing import PosesConfig
    from simscenes import load_set

    registered, viewmats = list[int](), np.zeros((0, 4, 4))
    with TemporaryDirectory() as folder:
        (taken := Path(folder) / "taken").mkdir()
        for i, picture in enumerate(codes):
            Image.fromarray(picture).save(taken / f"{i:04d}.png")
        with suppress(ValueError):  # too few views, which is a measurement too
            config = PosesConfig(photographs=taken, seed=seed, **settings)
            stages.poses(Path(folder) / "set", config, Console(quiet=True))
            found = load_set(Path(folder) / "set")
            registered, viewmats = [int(name) for name in found.names], found.rig.viewmats
    return poses(viewmats, true, registered)


def poses(found: np.ndarray, true: np.ndarray, registered: Sequence[int]) -> dict[str, float]:
    """Scores of cameras [R, 4, 4] against the true ones [C, 4, 4]."""
    from novags.cameras.align import auc, pair_errors, trajectory_error

    errors = dict(zip(("rotation", "translation"), pair_errors(found, true, registered), strict=True))
    areas = {f"{what}_auc{t:g}": auc(errors[what], t) for what in errors for t in AREAS}
    trajectory = trajectory_error(found, true[list(registered)]) if len(registered) > 2 else math.nan
    return {"registered": len(registered) / len(true), **areas, "trajectory": trajectory}


def read_rows(path: Path) -> dict[tuple[str, ...], dict[str, float]]:
    """The rows of earlier commands."""
    if not path.exists():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        return {tuple(row[name] for name in PLACE): {name: float(row[name]) for name in SCORES}
                for row in csv.DictReader(file)}  # fmt: skip


def write_rows(path: Path, rows: dict[tuple[str, ...], dict[str, float]]) -> None:
    """Write all rows, each number to four digits."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*PLACE, *SCORES])
        writer.writerows([*place, *(f"{row[name]:.4g}" for name in SCORES)] for place, row in rows.items())


def table(rows: dict[tuple[str, ...], dict[str, float]]) -> str:
    """Markdown: by source and light the mean over the scenes, and its standard error where there are several."""
    heads = ["cameras", "e-", "scenes", "registered", "rotation AUC@5", "@30", "translation AUC@5", "@30",
             "trajectory", "depth, %", "CPU s"]  # fmt: skip
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    kinds = dict.fromkeys((burst, cameras) for _, _, burst, cameras, _ in rows)
    lights = sorted({float(place[1]) for place in rows}, reverse=True)
    for burst, cameras in kinds:
        for electrons in lights:
            these = [row for place, row in rows.items() if place[1:4] == (f"{electrons:g}", burst, cameras)]
            if these:
                name = f"{cameras}, mean of {burst}" if burst != "1" else cameras
                cells = [cell([100 * row[s] if s == "depth" else row[s] for row in these], s) for s in SCORES]
                lines.append(f"| {name} | {electrons:g} | {len(these)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def apart(rows: dict[tuple[str, ...], dict[str, float]]) -> str:
    """Markdown: by source how far its areas are above the first source's, paired by scene and light."""
    from novags.testbed.metrics.differences import difference

    def values(cameras: str, score: str) -> dict[tuple[str, str, str], float]:
        return {
            (scene, seed, light): row[score]
            for (scene, light, burst, source, seed), row in rows.items()
            if (burst, source) == ("1", cameras)
        }

    first, *others = dict.fromkeys(source for _, _, burst, source, _ in rows if burst == "1")
    lines = [f"| over {first} | {' | '.join(SCORES[:5])} |", "|---" * 6 + "|"]
    for cameras in others:
        found = [difference(values(cameras, score), values(first, score)) for score in SCORES[:5]]
        cells = ("–" if one is None or one.error is None else f"{one.value:+.2f} ± {one.error:.2f}{'*' * one.seen}"
                 for one in found)  # fmt: skip
        lines.append(f"| {cameras} | {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(values: Iterable[float], score: str) -> str:
    """The mean of what there is and its standard error over the scenes."""
    known = [value for value in values if not math.isnan(value)]
    digits = {"seconds": 0, "depth": 1, "trajectory": 3}.get(score, 2)
    if not known:
        return "–"
    error = f" ± {np.std(known, ddof=1) / math.sqrt(len(known)):.{digits}f}" if len(known) > 1 else ""
    return f"{np.mean(known):.{digits}f}{error}"


def errors(options: argparse.Namespace) -> None:
    """Reconstruct the demo's capture from turned cameras, print the table."""
    from novags.cameras.sources.known import KnownConfig
    from novags.testbed import stages
    from novags.testbed.console.terminal import Console
    from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

    demo, console, out = EXPERIMENTS["demo"], Console(), options.out
    stages.render(out / "set", demo.render, console)
    stages.capture(out / "set", out / "capture", demo.capture, console)
    print("| rotation error | PSNR | with refinement | rotation left |\n|---|---|---|---|")
    for degrees in options.degrees:
        cells, left = [], 0.0
        for refine in (False, True):
            preset = adapted(
                demo, methods=(options.method,), cameras=KnownConfig(rotation_deg=degrees), refine_cameras=refine,
                iterations=options.iterations,
            )  # fmt: skip
            folder = out / f"{options.method}-{degrees:g}{'-refined' if refine else ''}"
            record = stages.reconstruct(out / "capture", folder, preset.reconstruct(options.method), console)
            scores = stages.score(folder, console)["methods"][options.method]["mean"]
            cells.append(f"{scores['enhanced']['aligned_psnr']:.2f} dB")
            left = record["cameras"]["mean_rotation_deg"]
        print(f"| {degrees:g}° | {' | '.join(cells)} | {left:.2f}° |", flush=True)


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("light", help="poses against light")
    command.add_argument("--out", type=Path, required=True)
    command.add_argument("--scenes", nargs="+", default=list(SCENES))
    command.add_argument("--electrons", type=float, nargs="+", default=list(ELECTRONS))
    command.add_argument("--cameras", nargs="+", help="sources, instead of the usual ones of structure from motion")
    command.add_argument("--bursts", type=int, nargs="+", default=[1], help="frames of a view, with --cameras")
    command.add_argument("--seed", type=int, default=0)
    command.set_defaults(run=light)
    command = commands.add_parser("errors", help="PSNR against the rotation error of the cameras")
    command.add_argument("--out", type=Path, required=True)
    command.add_argument("--method", default="naive-l1")
    command.add_argument("--degrees", type=float, nargs="+", default=[0.0, 0.5, 1.0, 2.0, 4.0])
    command.add_argument("--iterations", type=int, help="of the fit; the demo's if not given")
    command.set_defaults(run=errors)
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    settle()
    main()
