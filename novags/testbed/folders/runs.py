"""Where runs lie: alone, as the rows of a study's table, or anywhere below a folder."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from novags.testbed.folders.run import EXPLAINED, RECORD, Run, open_run
from novags.testbed.ledger.contents import UNFINISHED, read_json
from sensor_model.files.door import resolved

EXPERIMENT = "experiment.json"  # in the folder of a study of one place, once its runs are done: the request
STUDY = "study.json"  # in the folder of a study of many places
TABLE = "results.json"  # in both
VERIFIED = "verify.json"  # in a folder of runs that were made again, which are nobody's results
ROWS: Any = {"axes": dict, "rows": [{"state": str, "folder": str}]}  # of the table
REPORT, REPORT_FILES = "report.html", "report.files"  # and the folders beside pages of many pictures


def runs_in(folders: Sequence[Path]) -> dict[str, Run]:
    """All runs of several folders, by names that differ.

    A folder is a run, a study, which has the finished runs of its table in their order, or one that holds such at any
    depth. A name is the run's own, after the folder it lies in and a slash where others have it too.

    Raises:
        ValueError: If no folder is given, or one holds no finished run.
    """
    if not folders:
        raise ValueError("name at least one folder of a run, of a study, or of several of them")
    places = {resolved(path): open_run(path) for folder in folders for path in _paths(folder)}
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


def studies_in(folders: Sequence[Path]) -> list[Path]:
    """The folders of studies with finished runs among several folders, or below them."""
    every = {resolved(path): path for folder in folders for path, done in _tables(folder).items() if done}
    return list(every.values())


def _paths(folder: Path) -> list[Path]:
    """The folders of the runs in one folder."""
    if not folder.is_dir():
        raise ValueError(f"no such folder: {folder}")
    if any((folder / name).exists() for name in (RECORD, UNFINISHED)):
        return [folder]
    studies = _tables(folder)
    found = list[Path]()
    for path, done in studies.items():
        if done is not None:
            if gone := [run for run in done if not run.is_dir()]:
                raise ValueError(f"{len(gone)} of the {len(done)} runs of {path} are not here, as {gone[0]}: the runs "
                                 "of a study lie in its store, which has to come with it")  # fmt: skip
            found += done
        elif (path / RECORD).exists() and studies.get(path.parent) is None:  # else the table says whether it is done
            found.append(path)
    if not found:
        raise ValueError(f"{folder} holds no finished run: neither a {RECORD}, nor a study with one in its {TABLE} (if "
                         "one is unfinished, run the same command again)")  # fmt: skip
    return found


def _tables(folder: Path) -> dict[Path, list[Path] | None]:
    """The finished runs of a folder of runs, or of every such folder below it: `_done` of each, by folder."""
    studies = {folder: _done(folder)}
    if studies[folder] is None:
        below = {path.parent for name in (TABLE, RECORD) for path in folder.rglob(name)
                 if not any(part.startswith(".") or part == EXPLAINED
                            for part in path.relative_to(folder).parts)
                 and not any((folder / above / VERIFIED).exists()
                             for above in path.relative_to(folder).parents[:-1])}  # fmt: skip
        studies = {path: _done(path) for path in sorted(below)}
    return studies


def _done(folder: Path) -> list[Path] | None:
    """The folders of the finished runs in the table of a study; None where there is none."""
    if not (folder / TABLE).exists() or "axes" not in read_json(folder / TABLE):  # nerfbaselines has such a file too
        return None
    table = read_json(folder / TABLE, ROWS)
    if "method" not in table["axes"]:
        return []  # captures of a data set, measurements of a curve
    return [folder / row["folder"] for row in table["rows"] if row["state"] == "done"]


def _ends(path: Path) -> list[tuple[str, ...]]:
    """The folders above a path without its anchor, the innermost first: the first of them, the first two, ..."""
    above = path.parent.parts[:0:-1]
    return [above[:depth] for depth in range(1, len(above) + 1)]
