"""The cost of a study, before any work: runs, stages that are there, time, memory, disk. Writes nothing."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from novags.testbed.console.memory import available_bytes
from novags.testbed.ledger.store import KINDS, costs, other_entries
from novags.testbed.study.conduct import KEPT, there
from novags.testbed.study.costs import Costs
from novags.testbed.study.differences import foreseen
from novags.testbed.study.engines.choice import Engine
from novags.testbed.study.engines.progress import duration
from novags.testbed.study.light import METHOD
from novags.testbed.study.plan import StudyPlan
from novags.testbed.study.simulate import makespan, said_threads, simulated

SHOWN = 40  # runs listed by name


def forecast(
    plan: StudyPlan, store: Path, engine: Engine, *, url: str | None = None, nodes: Sequence[int] = ()
) -> str:  # fmt: skip
    """A page for a terminal.

    Args:
        plan: The study.
        store: The store.
        engine: Where the work would be done.
        url: Where the store is, if `store` holds only this machine's part of it.
        nodes: Numbers of nodes like this machine to simulate.

    Raises:
        ValueError: If a number of nodes is below 1.
    """
    count, threads = engine.places, engine.threads
    found, known = Costs.of(costs(store), threads), there(plan, store)
    predicted = {key: found.predicted(task) for key, task in plan.tasks.items()}
    seconds = {key: KEPT if key in known else cost.seconds for key, cost in predicted.items()}
    lines = [_head(plan), "", f"  {'stage':<10}{'needed':>8}{'there':>8}{'to do':>8}{'each':>10}{'memory':>10}"
             f"{'disk':>10}"]  # fmt: skip
    for kind in KINDS:
        keys = [key for key, task in plan.tasks.items() if task.kind == kind]
        new = [predicted[key] for key in keys if key not in known]
        if keys:
            each = duration(sum(c.seconds for c in new) / len(new)) if new else "-"
            memory = size(max(c.memory for c in new)) if new else "-"
            lines.append(f"  {kind:<10}{len(keys):>8}{len(keys) - len(new):>8}{len(new):>8}{each:>10}{memory:>10}"
                         f"{size(sum(c.disk for c in new)):>10}")  # fmt: skip
    todo = {key: cost for key, cost in predicted.items() if key not in known}
    peak = sum(sorted((cost.memory for cost in todo.values()), reverse=True)[:count])
    disk, free = sum(cost.disk for cost in todo.values()), shutil.disk_usage(_existing(store)).free
    lines += [
        "",
        f"  time    {duration(makespan(plan, seconds, count))} with {count} workers of {said_threads(threads)}; "
        f"{duration(sum(seconds.values()))} of work"
        + ("" if all(found.known(plan.tasks[key]) for key in todo) else " (nothing like it in the store: rough)"),
        f"  memory  at most {size(peak)} of {size(available_bytes())} free; fewer tasks at a time where it is short",
        f"  disk    {size(disk)} of {size(free)} free in {store}"
        if url is None
        else f"  disk    {size(disk)} at {url}",
    ]
    if plan.study.ends == "run" and len(plan.study.axes.get(METHOD, ())) > 1:
        lines.append(f"  sees    {foreseen(plan.study.axes, plan.study.cells)}")
    if url is None and disk > free:
        lines.append("  note: the disk is too small: free some, or choose another --store")
    if stray := other_entries(store, set(plan.tasks)):
        lines.append(f"  the store holds {stray} entries of other studies, settings or versions of novags")
    return "\n".join([*lines, *simulated(plan, predicted, seconds, engine, nodes)])


def _head(plan: StudyPlan) -> str:
    study = plan.study
    product = " x ".join(f"{len(values)} {name}" for name, values in study.axes.items())
    product = product if study.ends != "measurement" else f"{product}, each knob turned alone"
    without = f", {study.excluded} excluded" if study.excluded else ""
    lines = [f"{study.path}: {len(plan.runs)} {study.ends}s = {product}{without}"]
    lines += [f"  {number:>4}  {cell.label}" for number, (cell, _) in enumerate(plan.runs[:SHOWN], 1)]
    more = len(plan.runs) - SHOWN
    return "\n".join([*lines, *([f"        and {more} more"] if more > 0 else [])])


def size(count: float) -> str:
    """Bytes in the unit that suits them."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if count >= factor:
            return f"{count / factor:.1f} {unit}"
    return f"{count / 1e3:.0f} kB"


def _existing(path: Path) -> Path:
    """The existing folder, of a path and the folders above it."""
    return next(parent for parent in (path.absolute(), *path.absolute().parents) if parent.exists())
