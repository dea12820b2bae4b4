"""`novags pareto`: the cost of accuracy in time."""

from pathlib import Path
from typing import TYPE_CHECKING

from novags.commands.shared import next_, say, typed, writing
from novags.commands.study import store_folder
from novags.options import Name

if TYPE_CHECKING:
    from novags.testbed.console.terminal import Console
    from novags.testbed.study.plan import StudyPlan


def pareto(
    what: Name, *, out: Path, store: str | None = None, knobs: tuple[str, ...] = (), quick: bool = False,
    repeats: int | None = None, overwrite: bool = False, wait: bool = False, dry_run: bool = False,
) -> None:  # fmt: skip
    """Measure the cost of accuracy in time: every knob's error against its seconds.

    It is a study whose runs are measurements, one at a time with the whole machine. Each goes to the store at once: the
    same command again makes only missing ones.

    Args:
        what: render, sensor, splats, a method that declares knobs (whole reconstructions by it), or all; or a study
            file of your own with a table [measure].
        out: Folder of the curves (curves.jsonl), of a figure and tables for each of these, and of the tables of their
            studies.
        store: Folder of all measurements, which studies share; `store` beside `out` if not given.
        knobs: Measure these alone, by name; stored measurements of the others stay.
        quick: Small sizes and fewer settings: minutes instead of hours for all. The sizes stand in every line.
        repeats: Measurements of each setting, whose spread gives the error bars; 3 if not given, 2 with --quick.
        overwrite: Replace tables of other sizes that lie in `out`.
        wait: If another process is writing to `out`, wait until it is done instead of refusing.
        dry_run: Only say which measurements are missing, and which files would be made, or made again. Nothing is
            measured or written.
    """
    from novags.numbers import check_range
    from novags.testbed.ledger.dry import planned
    from novags.testbed.report.curves.page import written
    from novags.testbed.study.curves.study import plans, subject_of, told
    from novags.testbed.study.session import again, refuse_other

    check_range("repeats", 1 if repeats is None else repeats, 1, 1000)
    folder, failed = store_folder(store, out), 0
    with writing(out, wait, dry_run=dry_run) as console:
        found = plans(what, folder, console, knobs=knobs, quick=quick, repeats=repeats)
        for plan in found:
            name = subject_of(plan)
            if not overwrite:
                refuse_other(plan, out / name)
            if why := again(plan, out / name, folder):
                console.note(f"pareto {name}: made again: {why}")
            if dry_run:
                for line in told(plan, folder):
                    console.note(line)
            else:
                failed += _measured(plan, out, folder, console)
        names = [subject_of(plan) for plan in found]
        planned(console, "pareto", dict.fromkeys(path for name in names for path in (*written(name, out), out / name)))
        next_(f"look at {out}, or: novags run --budget 120s --curves {typed(out)}")
        if failed:
            raise SystemExit(1)


def _measured(plan: "StudyPlan", out: Path, store: Path, console: "Console") -> int:
    """Make missing measurements and write the curves; returns how many failed, which the next start tries again."""
    from novags.testbed.report.curves.page import write
    from novags.testbed.study.conduct import conduct
    from novags.testbed.study.engines.choice import OneMachine
    from novags.testbed.study.knobs.subjects import subject_of
    from novags.testbed.study.results import CSV
    from novags.testbed.study.session import describe

    measured = plan.runs[0][0].measured
    assert measured is not None
    folder = out / measured.of
    describe(plan, folder, store)
    try:
        rows = conduct(plan, folder, store, console, OneMachine.whole(), retry_failed=True)
    except KeyboardInterrupt:
        console.note(f"pareto {measured.of}: stopped; finished measurements are kept in {store}")
        raise
    failed = sum(row["state"] != "done" for row in rows)
    if failed:
        say(f"pareto {measured.of}: {failed} of {len(rows)} measurements failed; the reasons are in {folder / CSV}")
    if failed < len(rows):
        for path in write(subject_of(measured.of, measured.sizes), rows, out):
            say(path)
    return failed
