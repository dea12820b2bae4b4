"""Processor time and peak memory of methods on one capture, each in a process of its own.

    python scripts/bench_methods.py CAPTURE --methods naive nova-fast nova-plus --out DIR
    python scripts/bench_methods.py CAPTURE --methods naive nova-fast --iterations 600 --rounds 3 --set denoiser=none

CAPTURE is the folder of a capture, such as the one of `./scripts/demo`. Methods have the settings of the preset. Each
round trains every method once, in turn; a row gives the least processor seconds of the rounds, their ratio to the first
method, the iteration alone, and the largest resident memory. Kernels are compiled before the clock starts.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from novags.methods import METHODS
from novags.process import settle
from novags.settings import changed
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.stages.reconstructing import prepare
from novags.testbed.study.cells.presets import EXPERIMENTS


def train(options: argparse.Namespace, name: str) -> dict[str, Any]:
    """Train one method in this process; processor seconds of the whole and of its parts."""
    settle()
    torch.set_num_threads(1)
    settings = dict(setting.split("=", 1) for setting in options.set)
    preset = replace(EXPERIMENTS[options.preset], methods=(name,))
    config = preset.reconstruct(name)
    if options.iterations:
        settings["fit.iterations"] = str(options.iterations)
    config = replace(config, config=changed(config.config, settings))
    console = Console(quiet=True)
    capture = open_capture(options.capture)
    problem = prepare(capture, capture.source(console), config, console).problem
    method = METHODS[config.variant.method]
    # A few iterations first: what is compiled or imported then is not counted.
    method.train(problem, changed(config.config, {"fit.iterations": "4"}), progress=None, checkpoint=None)
    started = time.process_time()
    result = method.train(problem, config.config, progress=None, checkpoint=None)
    seconds = time.process_time() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"method": name, "seconds": seconds, "parts": result.seconds, "peak_mb": peak, "loss": result.losses[-1]}


def table(rounds: list[dict[str, Any]], first: str) -> str:
    """A Markdown table: the least of the rounds of each method."""
    best: dict[str, dict[str, Any]] = {}
    for row in rounds:
        if row["method"] not in best or row["seconds"] < best[row["method"]]["seconds"]:
            best[row["method"]] = row
    lines = [f"| method | CPU s | ÷ {first} | parts, s | peak MB |", "|---|---|---|---|---|"]
    for name, row in best.items():
        parts = ", ".join(f"{part} {value:.1f}" for part, value in row["parts"].items())
        ratio = row["seconds"] / best[first]["seconds"]
        lines.append(f"| {name} | {row['seconds']:.1f} | {ratio:.2f} | {parts} | {row['peak_mb']:.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Run as the module says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--methods", nargs="+", default=["naive", "nova-fast", "nova-plus"])
    parser.add_argument("--preset", default="demo", choices=sorted(EXPERIMENTS))
    parser.add_argument("--iterations", type=int, help="instead of the preset's")
    parser.add_argument("--set", nargs="*", default=[], metavar="SETTING=VALUE", help="for every method")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder for methods.json and methods.md")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(train(options, options.one)))
        return
    rows = []
    for _ in range(options.rounds):
        for name in options.methods:
            command = [sys.executable, __file__, *sys.argv[1:], "--one", name]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            rows.append(json.loads(done.stdout.splitlines()[-1]))
            print(f"{name}: {rows[-1]['seconds']:.1f} CPU s", file=sys.stderr, flush=True)
    text = table(rows, options.methods[0])
    print(text)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "methods.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        (options.out / "methods.md").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
