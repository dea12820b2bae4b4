"""What the bed costs beside the bare stages, and how well a study keeps two cores busy.

    python scripts/bench_study.py --out DIR

Twelve runs (two methods, six seeds of the camera's noise) of one tiny set, every process with one thread:

    bare     the stages as functions, one after the other, in one process: render, capture, reconstruct, score
    alone    novags study --workers 1
    study    novags study --workers 2

Prints JSON: seconds on the clock and of the processors for each; how much more processor time the study takes with one
worker than the bare stages, which is the cost of the bed (`beyond`), and with two, whose runs also wait for each
other's memory (`beyond_two`); and the time of two on the clock as a share of that of the bare stages (`share`).
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from novags.testbed.study.engines.processes import threads_environment

STUDY = """
preset = "demo"
[grid]
scene = ["tabletop"]
method = ["naive", "naive-l1"]
seed = [0, 1, 2, 3, 4, 5]
[override]
views = 16
width = 128
height = 128
spp = 32
points = 8000
iterations = {iterations}
"""


def bare(out: Path, iterations: int) -> None:
    """The stages of the study without it."""
    from novags.testbed import stages
    from novags.testbed.console import Console
    from novags.testbed.study.grid import read_study

    file, console, made = out / "study.toml", Console(quiet=True), set[Path]()
    file.write_text(STUDY.format(iterations=iterations))
    for cell in read_study(file).cells:
        preset, (name,) = cell.preset, cell.preset.methods
        capture = out / f"capture-{preset.capture.seed}"
        if not made:
            stages.render(out / "set", preset.render, console)
        if capture not in made:
            stages.capture(out / "set", capture, preset.capture, console)
            made.add(capture)
        run = out / f"{name}-{preset.capture.seed}"
        stages.reconstruct(capture, run, preset.reconstruct(name), console)
        stages.score(run, console)


def timed(folder: Path, *command: str) -> dict[str, float]:
    """Seconds of a command, on the clock and of all processors."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, **threads_environment(1)}
    subprocess.run([sys.executable, *command], check=True, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"seconds": time.perf_counter() - began, "cpu_seconds": cpu}


def measure(out: Path, iterations: int) -> dict[str, Any]:
    """Both, and the two ratios."""
    found: dict[str, Any] = {"iterations": iterations}
    here = ("--child", "--out", ".", "--iterations", str(iterations))
    found["bare"] = timed(out / "bare", str(Path(__file__).resolve()), *here)
    file = out / "study.toml"
    file.write_text(STUDY.format(iterations=iterations))
    words = ("-m", "novags", "study", str(file.resolve()), "--out", "made", "--workers")
    for name, workers, more in (("alone", "1", "beyond"), ("study", "2", "beyond_two")):
        found[name] = timed(out / name, *words, workers)
        found[more] = found[name]["cpu_seconds"] / found["bare"]["cpu_seconds"] - 1
    found["share"] = found["study"]["seconds"] / found["bare"]["seconds"]
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--iterations", type=int, default=400)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    if asked.child:
        bare(asked.out, asked.iterations)
    else:
        print(json.dumps(measure(asked.out, asked.iterations), indent=1))


if __name__ == "__main__":
    main()
