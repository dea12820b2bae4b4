"""What the bed costs beside the bare stages, and how well a study keeps two cores busy.

    python scripts/bench_study.py --out DIR

Twelve runs (two methods, six seeds of the camera's noise) of one tiny set, every process with one thread. The set is
rendered before, because a render takes all cores in any case and says nothing about runs side by side:

    bare     the stages as functions, one after the other, in one process on one core: capture, reconstruct, score
    alone    novags study --workers 1, on one core
    study    novags study --workers 2
    empty    tasks that compute nothing, in an entry of the store each, by one worker

Prints JSON: seconds on the clock and of the processors for each, the least of the rounds; how much more processor time
the study takes with one worker than the bare stages (`beyond`), and with two, whose runs wait for each other's memory
(`beyond_two`); the time of two on the clock as a share of the bare stages' (`share`; `shares` of the rounds).
`per_task` is the processor time that each further task costs the bed, from many empty ones: the differences above are
mostly those between two runs of the same work on a machine that is not alone.
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from novags.process import settle
from novags.testbed.console.terminal import Console
from novags.testbed.ledger.code import Code
from novags.testbed.ledger.stage import run_stage
from novags.testbed.study.engines.local import Pool, PoolLimits
from novags.testbed.study.engines.processes import threads_environment
from novags.testbed.study.engines.worker import Outcome
from novags.testbed.study.entry import Order, StageStep, Task, ensure

STUDY = """
preset = "demo"
[grid]
scene = ["tabletop"]
method = ["naive", "naive-l1"]
seed = {seeds}
[override]
views = 16
width = 128
height = 128
spp = 32
points = 8000
iterations = {iterations}
"""
SEEDS = [0, 1, 2, 3, 4, 5]
OTHER = [6]  # its runs put the set into the store before anything is measured


def bare(out: Path, iterations: int, seeds: list[int]) -> None:
    """The stages of the study without it, for a set that is there or is made."""
    from novags.testbed import stages
    from novags.testbed.console.terminal import Console
    from novags.testbed.study.cells.grid import read_study

    file, console, made = out / "study.toml", Console(quiet=True), set[Path]()
    file.write_text(STUDY.format(iterations=iterations, seeds=seeds))
    for cell in read_study(file).cells:
        preset, (name,) = cell.preset, cell.preset.methods
        capture = out / f"capture-{preset.capture.seed}"
        if not (out / "set").exists():
            stages.render(out / "set", preset.render, console)
        if capture not in made:
            stages.capture(out / "set", capture, preset.capture, console)
            made.add(capture)
        run = out / f"{name}-{preset.capture.seed}"
        stages.reconstruct(capture, run, preset.reconstruct(name), console)
        stages.score(run, console)


def timed(folder: Path, cores: int, *command: str) -> dict[str, float]:
    """Seconds of a command in a folder on so many cores, on the clock and of all processors."""
    allowed = sorted(os.sched_getaffinity(0))[:cores]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, **threads_environment(1)}
    subprocess.run([sys.executable, *command], check=True, cwd=folder, env=environment, stdout=subprocess.DEVNULL,
                   preexec_fn=lambda: os.sched_setaffinity(0, allowed))  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"seconds": time.perf_counter() - began, "cpu_seconds": cpu}


def nothing(order: Order, console: Console) -> dict[str, Any]:
    """A stage without work, for `empty`."""
    made = "made.json"

    def stage() -> None:
        run_stage("nothing", order.folder, made, code=Code({}, {}), inputs=lambda: {}, config={}, owns=(made,),
                  prepare=lambda: None, work=lambda _: {}, console=console)  # fmt: skip

    return ensure(order, {"nothing": StageStep(stage, made)}, console)


def empty(folder: Path, count: int) -> float:
    """Processor seconds of a pool of one worker for so many empty tasks."""
    shutil.rmtree(folder, ignore_errors=True)
    tasks = {f"{k:04d}": Task("run", f"{k:04d}", f"{k:04d}", None) for k in range(count)}

    def request(key: str, results: Mapping[str, Any]) -> dict[str, Any]:
        task = tasks[key]
        order = Order(task, task.folder(folder), None, {}, threads=1)
        return {"task": order, "log": str(folder / "logs" / key)}

    before = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    Pool("bench_study:nothing", request, PoolLimits(1), Mute(), threads_environment(1)).run(tasks.values())
    after = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(b.ru_utime + b.ru_stime - a.ru_utime - a.ru_stime for a, b in zip(before, after, strict=True))


class Mute:
    """Hears of tasks, and objects to failing ones."""

    def ended(self, key: str, outcome: Outcome) -> None:
        """A task has ended."""
        assert outcome.state == "done", (key, outcome)

    def __getattr__(self, name: str) -> Any:
        return lambda *told: None


def least(measured: list[dict[str, float]]) -> dict[str, float]:
    """The fastest of several: other work on a machine only adds."""
    return {name: min(found[name] for found in measured) for name in measured[0]}


def measure(out: Path, iterations: int, rounds: int) -> dict[str, Any]:
    """All of them, in turn, the least of so many rounds, and the ratios."""
    before, file = out / "before.toml", out / "study.toml"
    before.write_text(STUDY.format(iterations=1, seeds=OTHER))
    file.write_text(STUDY.format(iterations=iterations, seeds=SEEDS))
    measured: dict[str, list[dict[str, float]]] = {"bare": [], "alone": [], "study": []}
    for _ in range(rounds):
        for name in measured:
            shutil.rmtree(out / name, ignore_errors=True)
            (out / name).mkdir(parents=True)
        here = (str(Path(__file__).resolve()), "--child", "--out", ".")
        timed(out / "bare", 2, *here, "--iterations", "1", "--seeds", *map(str, OTHER))
        words = (*here, "--iterations", str(iterations), "--seeds", *map(str, SEEDS))
        measured["bare"].append(timed(out / "bare", 1, *words))
        for name, workers in (("alone", 1), ("study", 2)):
            words = ("-m", "novags", "study", "--store", "store", "--workers", str(workers), "--out")
            timed(out / name, 2, *words, "before", str(before.resolve()))
            measured[name].append(timed(out / name, workers, *words, "made", str(file.resolve())))

    found: dict[str, Any] = {"iterations": iterations, "rounds": rounds}
    found |= {name: least(of) for name, of in measured.items()}
    for name, more in (("alone", "beyond"), ("study", "beyond_two")):
        found[more] = found[name]["cpu_seconds"] / found["bare"]["cpu_seconds"] - 1
    few, many = (empty(out / "empty", count) for count in (20, 420))
    found["per_task"] = (many - few) / 400
    found["share"] = found["study"]["seconds"] / found["bare"]["seconds"]
    found["shares"] = [s["seconds"] / b["seconds"] for s, b in zip(measured["study"], measured["bare"], strict=True)]
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--iterations", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    if asked.child:
        bare(asked.out, asked.iterations, asked.seeds)
    else:
        print(json.dumps(measure(asked.out, asked.iterations, asked.rounds), indent=1))


if __name__ == "__main__":
    settle()
    main()
