"""`novags pareto`: what accuracy costs in time."""

from pathlib import Path

from novags.commands.shared import next_, say, typed, writing
from novags.options import Name


def pareto(
    what: Name, *, out: Path, knobs: tuple[str, ...] = (), quick: bool = False, repeats: int | None = None,
    overwrite: bool = False, wait: bool = False, dry_run: bool = False,
) -> None:  # fmt: skip
    """Measure what accuracy costs in time: every knob's error against its seconds, see docs/accuracy-and-time.md.

    Each measurement is on disk as soon as it is made: the same command again does only what is missing.

    Args:
        what: render, sensor, splats, a method that declares knobs (whole reconstructions by it), or all.
        out: Folder of the curves (curves.jsonl), and of a figure and tables for each of these.
        knobs: Measure these alone, by name; what the folder has of the others stays.
        quick: Small sizes and fewer settings: minutes instead of hours for all. The sizes stand in every line.
        repeats: Measurements of each setting, whose spread gives the error bars; 3 if not given, 2 with --quick.
        overwrite: Drop measurements of other sizes, another machine or other software that lie in `out`.
        wait: If another process is writing to `out`, wait until it is done instead of refusing.
        dry_run: Only say which measurements are missing, and which files would be made, or made again. Nothing is
            measured or written.
    """
    from novags.numbers import check_range
    from novags.testbed.ledger.dry import planned
    from novags.testbed.pareto.measure import measure
    from novags.testbed.pareto.page import write, written
    from novags.testbed.pareto.samples import work_folder
    from novags.testbed.pareto.subjects import chosen

    check_range("repeats", 1 if repeats is None else repeats, 1, 1000)
    made, count = chosen(what), (2 if quick else 3) if repeats is None else repeats
    with writing(out, wait, dry_run=dry_run) as console:
        subjects = [make(quick, work_folder(out), console) for make in made]
        for subject in subjects:
            try:
                samples = measure(subject, out, count, console, only=knobs, overwrite=overwrite)
            except KeyboardInterrupt:
                console.note(f"pareto {subject.name}: stopped; what was measured is kept in {out}")
                raise
            if not dry_run:
                for path in write(subject, samples, out):
                    say(path)
        planned(console, "pareto", dict.fromkeys(path for subject in subjects for path in written(subject, out)))
        next_(f"look at {out}, or: novags run --budget 120s --curves {typed(out)}")
