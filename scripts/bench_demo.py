"""The figures of the README: the demo over seeds, on other scenes, over iterations.

    python scripts/bench_demo.py --out DIR
        the demo, three seeds, all methods
    python scripts/bench_demo.py --out DIR --scenes cornell courtyard --seeds 0
        scenes that no setting was chosen on
    python scripts/bench_demo.py --out DIR --scenes tabletop:1 --seeds 0 --iterations 1200 2000 2400
        what longer training brings

Every run is `novags run` in a process of its own; finished work is kept, and so are all reports. Prints one Markdown
table a scene and number of iterations: means over seeds and test views, with the aligned PSNR of each seed.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

METHODS = ("naive", "nova-fast", "naive-l1", "nova-plus", "oracle")


def run(out: Path, scene: str, seed: int, iterations: int, methods: list[str]) -> dict[str, Any]:
    """Metrics of one experiment, from its folder or by running it."""
    folder = folder_of(out, scene, seed, iterations)
    command = [sys.executable, "-m", "novags", "run", "--scene", scene, "--seed", str(seed), "--out", folder]
    subprocess.run([*command, "--iterations", str(iterations), "--methods", *methods], check=True)
    metrics: dict[str, Any] = json.loads((folder / "metrics.json").read_text())
    return metrics


def folder_of(out: Path, scene: str, seed: int, iterations: int) -> Path:
    """Where an experiment lies."""
    return out / f"{scene.replace(':', '-')}-{seed}-{iterations}"


def picture(folder: Path, file: Path) -> None:
    """A row of images: dark, enhanced, denoised (a training view); naive, nova-fast, oracle (a held-out view)."""
    import cv2
    import numpy as np

    seen = ("capture/images/0007.png", "nova-fast/enhanced/0007.png", "nova-fast/denoised/0007.png")
    unseen = tuple(f"{method}/renders/0008.png" for method in ("naive", "nova-fast", "oracle"))
    images = [cv2.imread(str(folder / name)) for name in (*seen, *unseen)]
    gap = np.full((images[0].shape[0], 4, 3), 255, np.uint8)
    cv2.imwrite(str(file), np.hstack([part for image in images for part in (image, gap)][:-1]))


def mean(values: list[float]) -> float:
    """Arithmetic mean."""
    return sum(values) / len(values)


def table(runs: list[dict[str, Any]], methods: list[str]) -> str:
    """Markdown, a row a method."""
    lines = [
        "| | PSNR to enhanced | aligned PSNR (each seed) | SSIM | FLIP | tone-aligned PSNR to lit | depth error "
        "| training |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for method in methods:
        scores = [r["methods"][method] for r in runs]
        means = [s["mean"] for s in scores]
        aligned = [m["enhanced"]["aligned_psnr"] for m in means]
        seconds = mean([s["seconds"]["reconstruct"] for s in scores])
        cells = [
            f"{mean([m['enhanced']['psnr'] for m in means]):.2f} dB",
            f"{mean(aligned):.2f} dB ({', '.join(f'{v:.2f}' for v in aligned)})",
            f"{mean([m['enhanced']['ssim'] for m in means]):.3f}",
            f"{mean([m['enhanced']['flip'] for m in means]):.3f}",
            f"{mean([m['lit']['tone_aligned_psnr'] for m in means]):.2f} dB",
            f"{100 * mean([s['geometry']['abs_rel'] for s in scores]):.1f} %",
            f"{seconds:.0f} s",
        ]
        lines.append(f"| `{method}` | {' | '.join(cells)} |")
    training = [r["methods"]["nova-fast"].get("training_2d") for r in runs if "nova-fast" in r["methods"]]
    for key in ("enhanced", "blur", "best_blur", "denoised"):
        values = [t[key]["aligned_psnr"] for t in training if t and key in t]
        if values:
            lines.append(f"\ntraining images, {key}: {mean(values):.2f} dB ({', '.join(f'{v:.2f}' for v in values)})")
    return "\n".join(lines)


def main() -> None:
    """Do missing runs, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("bench_demo"))
    parser.add_argument("--scenes", nargs="+", default=["tabletop"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--methods", nargs="+", default=list(METHODS))
    parser.add_argument("--iterations", nargs="+", type=int, default=[2400])
    parser.add_argument("--picture", type=Path, help="PNG to write: what the first run sees and makes")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for scene in options.scenes:
        for iterations in options.iterations:
            runs = [run(options.out, scene, seed, iterations, options.methods) for seed in options.seeds]
            print(f"\n{scene}, {iterations} iterations, seeds {options.seeds}\n\n{table(runs, options.methods)}")
    if options.picture:
        first = folder_of(options.out, options.scenes[0], options.seeds[0], options.iterations[0])
        picture(first, options.picture)


if __name__ == "__main__":
    main()
