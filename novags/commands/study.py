"""`novags study`: a grid of runs."""

from pathlib import Path
from typing import Literal

from novags.commands import shared
from novags.commands.shared import next_, writing
from novags.options import Folder


def study(
    file: Folder, *, out: Path, store: Path | None = None, engine: Literal["local"] = "local",
    workers: int | None = None, dry_run: bool = False, retry_failed: bool = False, overwrite: bool = False,
    wait: bool = False,
) -> None:  # fmt: skip
    """Run a grid of scenes, cameras, light levels, methods and seeds from one file; see docs/studies.md.

    Stages that runs share are done once. Finished work is kept: the same command again does only what is missing. A run
    that fails becomes a row with its reason, and the rest goes on.

    Args:
        file: The study, a TOML file.
        out: Folder of its tables and logs.
        store: Folder of all sets, captures and runs, which studies share; `store` beside `out` if not given.
        engine: Where the work is done: on this machine.
        workers: Processes at a time; all cores are divided among them. As many as there are cores, or runs, if not
            given.
        dry_run: Only show the runs, and what they will take: time, memory, disk. Nothing is written.
        retry_failed: Try again the runs that failed before.
        overwrite: Replace tables of another study.
        wait: If another process is writing to `out`, wait until it is done instead of refusing.
    """
    from novags.testbed.study.conduct import conduct
    from novags.testbed.study.forecast import forecast
    from novags.testbed.study.grid import read_study
    from novags.testbed.study.plan import plan_of
    from novags.testbed.study.results import CSV, counted
    from novags.testbed.study.session import describe, refuse_other

    folder = out.parent / "store" if store is None else store
    plan = plan_of(read_study(file), folder, shared.console())
    if dry_run:
        print(forecast(plan, folder, workers))
        return
    with writing(out, wait) as console:
        if not overwrite:
            refuse_other(plan, out)
        describe(plan, out, folder)
        rows = conduct(plan, out, folder, console, workers=workers, retry_failed=retry_failed)
    states = counted(rows)
    print(f"{len(rows)} runs: {', '.join(f'{count} {state}' for state, count in states.items())}")
    print(out / CSV)
    if states.keys() - {"done"}:
        next_(f"look at the reasons in {out / CSV}, then: the same command with --retry-failed")
        raise SystemExit(1)
