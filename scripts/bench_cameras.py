"""How cameras fare in the dark.

    python scripts/bench_cameras.py errors --out DIR
        PSNR of the demo against a rotation error of its cameras, 0 to 4 degrees, with and without refinement
    python scripts/bench_cameras.py registered --set SET --out FILE.json
        the share of views that structure from motion registers, and how right they are, at 2 to 1000 electrons, on the
        dark pictures raw, enhanced, and enhanced and denoised, by both mappers

SET is a folder that `novags render` wrote. Results are kept in FILE.json row by row: the same command continues.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from novags.process import settle

ELECTRONS = (2.0, 5.0, 20.0, 80.0, 1000.0)
PICTURES = ("raw", "enhanced", "denoised")
MAPPERS = ("incremental", "global")
SENSOR = "a7s2-iso6400-3chip"
STEPS = 200  # of the denoiser: half a minute on an idle core
RIGHT_DEG = 5.0  # a registered camera further off than this is not a camera one could start from


def captured(radiances: list[np.ndarray], electrons: float, seed: int) -> Tensor:
    """Dark 8-bit pictures of one camera, [C, h, w, 3] in 0..1."""
    from sensor_model import PRESETS, Exposure, develop, expose, photons_for_electrons

    sensor, mean_green = PRESETS[SENSOR], float(np.mean([r[..., 1].mean() for r in radiances]))
    codes = []
    for view, radiance in enumerate(radiances):
        photons = photons_for_electrons(radiance, electrons=electrons, mean_green=mean_green, sensor=sensor)
        codes.append(develop(expose(photons, sensor, Exposure(time=1 / 30), seed=seed, view=view), sensor).srgb8)
    return torch.from_numpy(np.stack(codes).astype(np.float32) / 255)


def denoised(enhanced: Tensor, steps: int, seed: int) -> Tensor:
    """What the self-supervised denoiser of the preset demo makes of them after a short training."""
    from novags.methods.nova.denoiser import Denoiser
    from novags.methods.nova.denoiser_config import FAST_DENOISER

    denoiser = Denoiser(enhanced, FAST_DENOISER, total_steps=steps, seed=seed)
    for _ in range(steps):
        denoiser.train_step()
    return denoiser.denoise_all()


def measure(pictures: Tensor, dark: Tensor, true: np.ndarray, Ks: np.ndarray, mapper: str, seed: int) -> dict[str, Any]:
    """Share of the views that register and that are right, and the median rotation error of the registered ones."""
    from novags.cameras.align import align
    from novags.cameras.motion.sfm import structure_from_motion
    from novags.cameras.sources.sfm import SfmConfig

    codes = (pictures * 255).round().to(torch.uint8).numpy()
    start = time.perf_counter()
    row: dict[str, Any] = {"registered": 0.0, "right": 0.0, "rotation_deg": None, "centre_error": None}
    try:
        config = SfmConfig(mapper=mapper)
        found = structure_from_motion(codes, Ks, dark, n_points=1000, config=config, seed=seed)
        aligned = align(found.viewmats, torch.tensor(true)[list(found.registered)])
    except ValueError as error:  # too few views, which is a measurement too
        return row | {"seconds": time.perf_counter() - start, "error": str(error)}
    return {
        "registered": len(found.registered) / len(true),
        "right": int((aligned.rotation_deg < RIGHT_DEG).sum()) / len(true),
        "rotation_deg": float(aligned.rotation_deg.median()),
        "centre_error": float(aligned.centre_error.median()),
        "seconds": time.perf_counter() - start,
    }


def registered(options: argparse.Namespace) -> None:
    """Make missing measurements, print the table."""
    from novags.methods.enhancers.guided import enhance
    from simscenes import load_set

    multiview = load_set(options.set)
    true, Ks = multiview.rig.viewmats, multiview.rig.Ks
    radiances = [multiview.radiance(i) for i in range(len(multiview))]
    rows: dict[str, Any] = json.loads(options.out.read_text()) if options.out.exists() else {}
    for kind in options.pictures:
        for electrons in options.electrons:
            keys = {mapper: key_of(electrons, kind, mapper, options.seed) for mapper in MAPPERS}
            if all(key in rows for key in keys.values()):
                continue
            dark = captured(radiances, electrons, options.seed)
            pictures = dark if kind == "raw" else enhance(dark)[0]
            if kind == "denoised":
                pictures = denoised(pictures, options.steps, options.seed)
            for mapper, key in keys.items():
                rows[key] = measure(pictures, dark, true, Ks, mapper, options.seed)
                print(f"{key}: {rows[key]}", flush=True)
            options.out.write_text(json.dumps(rows, indent=1) + "\n")
    print(f"\n{table(rows, options.electrons, options.seed)}")


def key_of(electrons: float, kind: str, mapper: str, seed: int) -> str:
    """Name of a row of results."""
    return f"{electrons:g} {kind} {mapper} {seed}"


def table(rows: dict[str, Any], electrons: list[float], seed: int) -> str:
    """Markdown: a row for each kind of picture and mapper, a column for each light."""
    lines = [
        "| pictures, mapper | " + " | ".join(f"{e:g} e-" for e in electrons) + " |",
        "|---" * (len(electrons) + 1) + "|",
    ]
    for kind in PICTURES:
        for mapper in MAPPERS:
            cells = [cell(rows.get(key_of(e, kind, mapper, seed))) for e in electrons]
            lines.append(f"| {kind}, {mapper} | {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(row: dict[str, Any] | None) -> str:
    """Registered share, right share if it is smaller, median rotation error."""
    if row is None:
        return "not measured"
    if not row["registered"]:
        return "0 %"
    right = "" if row["right"] == row["registered"] else f" ({100 * row['right']:.0f} % right)"
    return f"{100 * row['registered']:.0f} %{right}, {row['rotation_deg']:.2f}°"


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
    command = commands.add_parser("registered", help="share of views that structure from motion registers")
    command.add_argument("--set", type=Path, required=True)
    command.add_argument("--out", type=Path, required=True)
    command.add_argument("--electrons", type=float, nargs="+", default=list(ELECTRONS))
    command.add_argument("--pictures", nargs="+", choices=PICTURES, default=list(PICTURES))
    command.add_argument("--steps", type=int, default=STEPS, help="of the denoiser")
    command.add_argument("--seed", type=int, default=0)
    command.set_defaults(run=registered)
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
