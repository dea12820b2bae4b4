"""An experiment on disk: set/, capture/, a folder for each run, experiment.json, metrics.json, report.html."""

from pathlib import Path

from novags.testbed.cache import UNFINISHED, read_json
from novags.testbed.folders import shapes
from novags.testbed.folders.run import RECORD, Run, open_run

EXPERIMENT = "experiment.json"
REPORT = "report.html"


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
