"""Does a denoiser that learnt one camera's simulated noise work on another camera's?

    for s in courtyard hall lantern thicket sofa bicycle; do
        novags render $s --views 8 --width 96 --height 96 --spp 256 --out out/other/sets/$s; done
    python scripts/denoising/another_camera.py out/other/sets/* --out out/other [--steps 6000] [--seeds 0 1 2]

`scripts/train_denoiser.py` trains the network of `denoise-gs` on synthetic pictures that were photographed by camera
A, by camera B, by both, by cameras drawn at random, and with the noise of dark frames of B: as many steps each, a
network for each seed. All are tested on photographs of B whose truth is known, of copies of it that no training had,
without adaptation. Scores are those of `scripts/bench_denoiser.py`; differences are paired by scene, seed, level and
kind of sensor, and their standard errors are over scenes. Finished trainings and scores are kept in --out.
"""

import argparse
import csv
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

SCRIPTS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(SCRIPTS))

from bench_denoiser import EXPOSURE, Pictures  # noqa: E402

from novags.methods.denoised.estimate import estimate_all  # noqa: E402
from novags.methods.denoised.weights import load_weights  # noqa: E402
from novags.process import settle  # noqa: E402
from novags.testbed.metrics.differences import Values, difference  # noqa: E402
from sensor_model import PRESETS, expose  # noqa: E402

LEVELS = (2.0, 5.0, 20.0, 80.0)
SCORES = ("psnr", "squared_error")
FIELDS = ("trained_on", "seed", "scene", "sensor", "electrons", *SCORES)
DARK = 64  # frames
SIDE = 160  # px, of dark frames
UNSEEN = 1_000_003  # serial of the copy of B that is tested: its fixed pattern is another one
Row = dict[str, str]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", type=Path, nargs="+", help="rendered sets")
    parser.add_argument("--a", default="a7s2-iso6400", help="a preset")
    parser.add_argument("--b", default="d850-iso6400", help="a preset: the camera that is tested")
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--crop", type=int, default=64, help="px")
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0, 1, 2], help="of the trainings and of the tested noise"
    )
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--out", type=Path, required=True)
    return parser.parse_args()


def main() -> None:
    asked = arguments()
    asked.out.mkdir(parents=True, exist_ok=True)
    dark, table = asked.out / "dark-frames", asked.out / "other-camera.csv"
    dark_frames(asked.b, dark)
    rows = list(csv.DictReader(table.open())) if table.exists() else []
    for seed in asked.seeds:
        for name, words in trainings(asked.a, asked.b, dark).items():
            weights = trained(name, words, seed, asked)
            rows += tested(name, weights, seed, asked, rows)
            with table.open("w", newline="") as file:
                writer = csv.DictWriter(file, FIELDS)
                writer.writeheader()
                writer.writerows(rows)
    print(shown(rows, asked.b))


def trainings(a: str, b: str, dark: Path) -> dict[str, list[str]]:
    """What networks are trained on, and the options that say so."""
    return {
        a: ["--cameras", a], b: ["--cameras", b], "both": ["--cameras", a, b], "any camera": [],
        f"dark frames of {b}": ["--cameras", b, "--dark-frames", str(dark)],
    }  # fmt: skip


def dark_frames(camera: str, folder: Path) -> None:
    """Frames of one copy of a camera without light, as its owner would take them."""
    folder.mkdir(exist_ok=True)
    for k in range(DARK):
        if not (file := folder / f"{k:02d}.npy").exists():
            frame = expose(np.zeros((SIDE, SIDE)), PRESETS[camera], EXPOSURE, seed=77, view=0, frame=k, threads=1)
            np.save(file, frame.dn)


def trained(name: str, words: list[str], seed: int, asked: argparse.Namespace) -> Path:
    """The weights of a network, which is trained unless it has been."""
    out: Path = asked.out / f"{name.replace(' ', '-')}-{seed}.safetensors"
    if not out.exists():
        command = [sys.executable, str(SCRIPTS / "train_denoiser.py"), *words, "--steps", str(asked.steps), "--rate",
                   "2e-3", "--crop", str(asked.crop), "--seed", str(seed), "--makers", "0",
                   "--out", str(out)]  # fmt: skip
        subprocess.run(command, check=True)
    return out


def tested(name: str, weights: Path, seed: int, asked: argparse.Namespace, rows: list[Row]) -> list[Row]:
    """The scores of a network on every set that lacks them."""
    there = {(row["trained_on"], row["seed"], row["scene"]) for row in rows}
    network, found = load_weights(weights), list[Row]()
    for folder in asked.sets:
        if (name, str(seed), folder.name) in there:
            continue
        for sensor in (f"{asked.b}-3chip", asked.b):
            for level in LEVELS:
                camera = replace(PRESETS[sensor], serial=UNSEEN)
                data = Pictures(folder, camera, level, asked.views, seed)
                p = data.pictures
                scores = data.scores(estimate_all(network, p.electrons, p.mask, p.read_variance, turns=1))
                row = {"trained_on": name, "seed": seed, "scene": folder.name, "sensor": sensor, "electrons": level}
                found.append({k: f"{v:g}" if isinstance(v, float) else str(v) for k, v in row.items()}
                             | dict(zip(SCORES, (f"{score:.5g}" for score in scores), strict=True)))  # fmt: skip
        print(name, seed, folder.name, flush=True)
    return found


def values(rows: list[Row], name: str, score: str) -> Values:
    """The scores of a training, by scene, seed, and level and kind of sensor."""
    return {(row["scene"], row["seed"], f"{row['sensor']} {row['electrons']}"): float(row[score])
            for row in rows if row["trained_on"] == name}  # fmt: skip


def shown(rows: list[Row], b: str) -> str:
    """Markdown: by training, the mean scores on B and how far they are above those of the training on B itself."""
    lines = ["| trained on | aligned PSNR, dB | over B | squared error | over B |", "|---|---|---|---|---|"]
    for name in dict.fromkeys(row["trained_on"] for row in rows):
        cells = [name]
        for score, digits in zip(SCORES, (2, 4), strict=True):
            mine = values(rows, name, score)
            cells.append(f"{np.mean(list(mine.values())):.{digits}f}")
            apart = difference(mine, values(rows, b, score))
            of = "" if name == b or apart is None else f"{apart.value:+.{digits}f}"
            error = f" ± {apart.error:.{digits}f}{'*' if apart.seen else ''}" if of and apart and apart.error else ""
            cells.append(of + error)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", "* seen at 95 %."])


if __name__ == "__main__":
    settle()
    torch.set_num_threads(1)
    main()
