"""An experiment on disk: set/, capture/, a folder for each run, experiment.json, metrics.json, report.html,
and report.files/ with its whole pictures where they are many.

And collections of runs, wherever they lie.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from novags.testbed.folders import shapes
from novags.testbed.folders.run import RECORD, Run, open_run
from novags.testbed.ledger.contents import UNFINISHED, read_json
from sensor_model.files.door import resolved

EXPERIMENT = "experiment.json"
REPORT, REPORT_FILES = "report.html", "report.files"


def find_runs(folder: Path) -> dict[str, Run]:
    """The runs of an experiment by name, in its order; or the single run, if `folder` is a run.

    Raises:
        ValueError: If `folder` is neither.
    """
    if not folder.is_dir():
        raise ValueError(f"no such folder: {folder}")
    if (folder / RECORD).exists() or (folder / UNFINISHED).exists():
        run = open_run(folder)
        return {run.name: run}
    if (folder / EXPERIMENT).exists():
        names = read_json(folder / EXPERIMENT, shapes.EXPERIMENT)["methods"]
        if not names:
            raise ValueError(f"{folder / EXPERIMENT} names no methods: run the same command again")
        return {name: open_run(folder / name) for name in names}
    raise ValueError(
        f"{folder} is neither a run (no {RECORD}) nor an experiment (no {EXPERIMENT}; if it is "
        "an unfinished one, run the same command again)"
    )


def experiments_in(folder: Path) -> list[Path]:
    """The folder itself if it is a run or an experiment, else every experiment and every other run below it, sorted.

    Raises:
        ValueError: If `folder` does not exist, or holds neither runs nor experiments.
    """
    if not folder.is_dir():
        raise ValueError(f"no such folder: {folder}")
    if any((folder / name).exists() for name in (RECORD, UNFINISHED, EXPERIMENT)):
        return [folder]
    found = [record.parent for name in (EXPERIMENT, RECORD) for record in folder.rglob(name)]
    visible = [path for path in found if not any(part.startswith(".") for part in path.relative_to(folder).parts)]
    parts = {path for path in visible if (path / EXPERIMENT).exists()}
    alone = [path for path in visible if not parts & {path, path.parent}]
    if not visible:
        find_runs(folder)  # which says what it is not
    return sorted({*parts, *alone})


def gather(folders: Sequence[Path]) -> dict[str, Run]:
    """All runs of several runs, experiments, or folders of such, by names that differ.

    A name is the run's own, after the folder it lies in and a slash where others have it too.

    Raises:
        ValueError: If no folder is given, or one holds neither runs nor experiments.
    """
    if not folders:
        raise ValueError("name at least one folder of a run, of an experiment, or of several of them")
    runs = [run for folder in folders for part in experiments_in(folder) for run in find_runs(part).values()]
    places = {resolved(run.path): run for run in runs}
    count = Counter(run.name for run in places.values())
    # How many runs of a name lie in folders that end alike, by that end, the innermost folder first.
    ends = Counter((run.name, end) for path, run in places.items() for end in _ends(path))
    named: dict[str, Run] = {}
    for path, run in places.items():
        name = run.name
        if count[run.name] > 1 or name in named:
            # Parent folders are added until no other run has that name.
            own = next((end for end in _ends(path) if ends[run.name, end] == 1), None)
            name = f"{'/'.join(reversed(own)) if own else run.path.name}/{run.name}"
        named[name] = run
    return named


def _ends(path: Path) -> list[tuple[str, ...]]:
    """The folders above a path without its anchor, the innermost first: the first of them, the first two, ..."""
    above = path.parent.parts[:0:-1]
    return [above[:depth] for depth in range(1, len(above) + 1)]
