"""What opening many runs for a report costs, beside another version of the sources in the same run.

    python scripts/files/bench_door.py [--runs 500] [--rounds 7] [--beside CHECKOUT]

A tiny set, capture and run are made and the run is copied. Opening is what `novags report FOLDER` does before it draws:
each run's record, scores and losses, its capture and set compared with their records. Every round is a process of its
own, of the two versions in turn; prints processor seconds of both, least and median, and the ratio of the medians.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MAKE = """
import sys
from novags.cli import main
small = ["--width", "32", "--height", "32", "--spp", "4"]
for words in (
    ["render", "cornell", "--views", "8", "--out", "set", "--variant", "scalar", *small],
    ["capture", "set", "--out", "capture"],
    ["reconstruct", "capture", "--method", "naive", "--points", "200", "--iterations", "30", "--out", "run"],
    ["score", "run"],
):
    sys.argv = ["novags", *words]
    main()
"""
OPEN = """
import resource, sys
from pathlib import Path
from novags.testbed.console.terminal import Console
from novags.testbed.folders.runs import runs_in
quiet = Console(quiet=True)
def used():
    spent = resource.getrusage(resource.RUSAGE_SELF)
    return spent.ru_utime + spent.ru_stime
start = used()
for run in runs_in([Path("runs")]).values():
    run.inputs(quiet), run.scores(), run.events()
print(used() - start)
"""


def python(program: str, folder: Path, sources: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(sources), "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, env=environment, text=True, capture_output=True)
    if done.returncode:
        sys.exit(done.stderr)
    return done.stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=500)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--beside", type=Path, help="root of another version's sources")
    options = parser.parse_args()
    trees = {"here": ROOT} | ({} if options.beside is None else {"beside": options.beside.resolve()})
    seconds: dict[str, list[float]] = {name: [] for name in trees}
    with tempfile.TemporaryDirectory(prefix="novags-bench-") as temporary:
        folder = Path(temporary)
        python(MAKE, folder, ROOT)
        (folder / "runs").mkdir()
        for name in ("set", "capture"):
            shutil.move(folder / name, folder / "runs" / name)
        for k in range(options.runs):
            shutil.copytree(folder / "run", folder / "runs" / f"run{k:04d}")
        for _ in range(options.rounds):
            for name, sources in trees.items():
                seconds[name].append(float(python(OPEN, folder, sources)))
    for name, found in seconds.items():
        print(f"{name}: {options.runs} runs opened in {min(found):.2f} s of processor time at least, "
              f"{statistics.median(found):.2f} s in the median of {len(found)}")  # fmt: skip
    if options.beside is not None:
        here, beside = (statistics.median(found) for found in seconds.values())
        print(f"ratio of the medians {here / beside:.3f}")


if __name__ == "__main__":
    main()
