"""A study of one place: a set, a capture of it, its reconstructions by every method, and scores, in one folder.

set/ (unless one is given)   capture/   a folder for each method or variant
results.csv   results.json   differences.csv   as of every study; failures.json and logs/ where there are any
experiment.json   report.html   the request, once all is done, and the page
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from novags.methods import METHODS
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders import capture as captures
from novags.testbed.folders import shapes
from novags.testbed.folders.place import place_of
from novags.testbed.folders.run import RECORD, Run
from novags.testbed.folders.runs import EXPERIMENT, REPORT, REPORT_FILES, ROWS, STUDY, TABLE, runs_in
from novags.testbed.ledger.contents import UNFINISHED, read_json, write_json
from novags.testbed.ledger.dry import NOT_DONE, dry_run, planned
from novags.testbed.ledger.stage import refuse_other
from novags.testbed.study.cells.grid import Cell, Study
from novags.testbed.study.cells.presets import Preset
from novags.testbed.study.conduct import FAILURES, conduct
from novags.testbed.study.differences import DIFFERENCES
from novags.testbed.study.engines.choice import Engine
from novags.testbed.study.engines.here import Here
from novags.testbed.study.entry import Task
from novags.testbed.study.plan import Planner, StudyPlan, check
from novags.testbed.study.results import CSV, rescored
from novags.testbed.study.steps import steps
from sensor_model.files.door import resolved
from sensor_model.files.lock import dry, locked

DESCRIBED = (EXPERIMENT, REPORT, REPORT_FILES)  # files that describe all runs in the folder
TAKEN = (
    "set",
    "capture",
    *DESCRIBED,
    CSV,
    DIFFERENCES,
    TABLE,
    FAILURES,
    "logs",
    UNFINISHED,
)  # beside the runs


def run(
    preset: Preset, out: Path, console: Console, *, report: Callable[[Path, Console], Path] | None = None,
    doubt: Callable[[list[Path]], str] | None = None, engine: Engine | None = None, command: str | None = None,
    overwrite: bool = False,
) -> Path:  # fmt: skip
    """Run the rest of the experiment in `out`; returns the path of the report, or `out` without one.

    Args:
        preset: The experiment.
        out: The folder.
        console: Where progress goes.
        report: Writes a report on the folder.
        doubt: Of the folders of all runs that are done: a doubt about the experiment, "" for none. It is said at once.
        engine: Where the work is done; None: in this process.
        command: The command line, for the record.
        overwrite: Replace finished results of another request.

    Raises:
        ValueError: If an input is wrong, or `out` holds other things or, unless `overwrite`, finished results of
            another request; that is said before any work. Or if a run fails: the others are done, and reported, first.
        BlockingIOError: If another process is writing to `out`.
    """
    refuse_impossible(preset)
    with locked(out):
        plan = _planned(preset, out, console, overwrite)
        here = Here(console)
        shows = Console(quiet=True) if engine is None else console

        def after(runs: list[Path]) -> None:
            if doubt is not None and (found := doubt(runs)):
                console.warn(found)

        rows = conduct(plan, out, out, shows, engine or here, retry_failed=True, after=after)
        page = out
        if any(row["state"] == "done" for row in rows):
            write_json(out / EXPERIMENT, {"command": command, "preset": asdict(preset)})
            page = page if report is None else report(out, console)
        if reasons := dict.fromkeys(str(row["reason"]) for row in rows if row["state"] != "done"):
            raise here.errors[0] if len(here.errors) == 1 else ValueError("; ".join(reasons))
        return page


def photograph(preset: Preset, out: Path, console: Console, *, overwrite: bool = False) -> Path:
    """The first half of `run`: make the set, if none is given, and take the pictures; returns the capture's folder."""
    with locked(out):
        for task in _planned(preset, out, console, overwrite).tasks.values():
            if task.kind != "run":
                for step in steps(task, task.folder(out), _source(task, out), console).values():
                    step.do()
        return out / "capture"


def refuse_impossible(preset: Preset) -> None:
    """Raise ValueError for an experiment that cannot be done, wherever it is to lie."""
    preset.refuse_lacking()
    if taken := [name for name in preset.methods if name in TAKEN]:
        raise ValueError(f"a variant must not be called {taken[0]}: the folder of an experiment holds something else "
                         "of that name")  # fmt: skip


def _planned(preset: Preset, out: Path, console: Console, overwrite: bool) -> StudyPlan:
    """Every task, each in a folder with a plain name.

    Raises:
        ValueError: If `out` is of a study of many places; if a request would replace finished results in it, unless
            `overwrite`; or as `plan.check`.
    """
    cells = tuple(Cell({"method": name}, replace(preset, methods=(name,))) for name in preset.methods)
    if (out / STUDY).exists():  # which would go on to describe the tables, whatever may be overwritten
        raise ValueError(f"{out} holds {STUDY}: its tables are of a study of many places; choose another --out")
    if not overwrite:
        _refuse_other(preset, out)
    check(cells[0].preset, console)
    planner = Planner(out, console)
    runs = tuple((cell, planner.run(cell.preset)) for cell in cells)
    tasks = {key: replace(task, place=task.group if task.kind == "run" else task.kind, overwrite=overwrite,
                          stale=DESCRIBED) for key, task in planner.tasks.items()}  # fmt: skip
    # The two ends of the scale come first: they show whether the rest is worth its time.
    ends = {name: METHODS[name].bound for name in preset.methods if name in METHODS and METHODS[name].bound}
    if len(set(ends.values())) > 1:
        tasks = dict(sorted(tasks.items(), key=lambda item: item[1].kind == "run" and item[1].place not in ends))
    return StudyPlan(Study(out, {"method": preset.methods}, cells, 0, {}), tasks, runs)


def _source(task: Task, out: Path) -> Path | None:
    """The input of a task: it has one at most, and plain names say which."""
    return out / ("capture" if task.kind == "run" else "set") if task.needs else task.source


def _refuse_other(preset: Preset, out: Path) -> None:
    """Refuse a request that would replace finished results in `out`, before any work."""
    if preset.folder is None:
        refuse_other(out / "set", "set.json", (preset.photos or preset.render).resolved())
    refuse_other(out / "capture", captures.RECORD, preset.capture.resolved())
    if preset.folder is None:
        _refuse_set_elsewhere(out)
    for name in preset.methods:
        refuse_other(out / name, RECORD, preset.reconstruct(name).resolved())
    if (out / TABLE).exists():
        before = [row["method"] for row in read_json(out / TABLE, ROWS)["rows"] if row["state"] == "done"]
        if lost := [name for name in before if name not in preset.methods]:
            raise ValueError(
                f"{out} holds a finished comparison with {', '.join(lost)}, which this request leaves out: name them "
                "too (--methods), choose another --out, or add --overwrite"
            )


def _refuse_set_elsewhere(out: Path) -> None:
    """Refuse to render for a finished capture of a set that lies elsewhere: it would be refused after the render."""
    record = out / "capture" / captures.RECORD
    if not record.exists():
        return
    made_of = place_of(out / "capture", read_json(record, shapes.CAPTURE)["set"]["path"])
    if made_of != resolved(out / "set"):
        raise ValueError(f"{out / 'capture'} is a finished capture of the set {made_of}, which this request does not "
                         "name: name it (--scene), choose another --out, or add --overwrite")  # fmt: skip


def said(preset: Preset, out: Path, console: Console, *, overwrite: bool = False) -> None:
    """Name the steps of `run`, and write nothing: which stages it would make, or make again and why.

    Raises:
        ValueError: As `run`.
    """
    refuse_impossible(preset)
    plan, made = _planned(preset, out, console, overwrite), dict[str, bool]()
    for key, task in plan.tasks.items():
        need = next(iter(task.needs), None)  # one at most, see `_source`
        folder, waits = task.folder(out), "" if need is None else f"the {plan.tasks[need].place}"
        again = need is not None and made[need]
        for number, (name, step) in enumerate(steps(task, folder, _source(task, out), console).items()):
            if again:  # an input that is made counts by its key: whether it comes out equal is seen then
                but = f", unless {waits} comes out as before" if (folder / step.record).exists() else ""
                console.note(f"{f'{name} ' * bool(number)}{task.place}: to be made{but} {NOT_DONE}")
                continue
            with dry_run() as kept:
                step.do()
            again, waits = kept == [False], task.place
        made[key] = again
    with dry_run():
        planned(console, "run", [out / name for name in (EXPERIMENT, CSV, DIFFERENCES, TABLE, REPORT)])


def together(folders: Sequence[Path]) -> dict[Path, list[Run]]:
    """Runs by the folder that is held while they are scored: the folder of their study of one place, or their own.

    Raises:
        ValueError: As `runs_in`.
    """
    found = dict[Path, list[Run]]()
    for run in runs_in(folders).values():
        found.setdefault(run.path.parent if _is_done(run.path.parent) else run.path, []).append(run)
    return found


def score_all(folder: Path, runs: Sequence[Run], console: Console) -> None:
    """Score runs; where they lie in the folder of a study of one place, its table is written again.

    Args:
        folder: Of the study, or of the only run.
        runs: The runs, see `together`.
        console: Where progress goes.

    Raises:
        ValueError: If the folders a run refers to are gone.
        BlockingIOError: If another process is writing there.
    """
    with locked(folder, make=False):
        for run in runs:
            with dry_run(dry.get()):  # in a dry run each names its steps
                stages.score(run.path, console)
        if _is_done(folder):
            planned(console, "score", [folder / name for name in (CSV, DIFFERENCES, TABLE)])
            rescored(folder)


def _is_done(folder: Path) -> bool:
    """Whether a folder holds a finished study of one place; version 0.1.0 wrote no table."""
    return (folder / EXPERIMENT).exists() and (folder / TABLE).exists()
