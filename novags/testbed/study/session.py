"""The folder of a study: whose it is, the changes of its file that it allows, and why finished results are made again.

study.json       the file, its combinations and where their runs are in the store
results.csv      results.json      one row a run
differences.csv  one row for each pair of methods and score
failures.json    failed tasks, by key; tried again on request
logs/            the output of each task
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from novags.testbed.folders.capture import RECORD as CAPTURE
from novags.testbed.folders.run import RECORD
from novags.testbed.folders.runs import EXPERIMENT, ROWS, STUDY, TABLE
from novags.testbed.ledger.code import code_of
from novags.testbed.ledger.contents import jsonable, read_json, write_json
from novags.testbed.ledger.difference import from_request, listed
from novags.testbed.ledger.made import made_with
from novags.testbed.ledger.stage import MADE
from novags.testbed.ledger.store import SEAL
from novags.testbed.study.cells.grid import Study
from novags.testbed.study.knobs.measurement import MEASURED
from novags.testbed.study.plan import StudyPlan
from novags.testbed.study.results import CSV, place_of

RECORDS = {"run": RECORD, "capture": CAPTURE, "measurement": MEASURED}  # by what a study ends with
SHAPE: Any = {"file": str, "table": dict, "runs": [{"values": dict, "key": str, "folder": str}]}


def describe(plan: StudyPlan, out: Path, store: Path, url: str | None = None) -> None:
    """Write study.json; `url`: where the store is, if it is not in the folder `store`."""
    runs = [
        {"values": cell.values, "key": key, "folder": place_of(plan.tasks[key], out, store, url)}
        for cell, key in plan.runs
    ]
    study = plan.study
    write_json(
        out / STUDY,
        {"file": study.path.name, "table": jsonable_table(study),
         "store": url or Path(os.path.relpath(store, out)).as_posix(),
         "axes": study.axes, "excluded": study.excluded, "runs": runs},
    )  # fmt: skip


def jsonable_table(study: Study) -> dict[str, Any]:
    """The content of the file; dates and times of TOML as text."""
    found: dict[str, Any] = jsonable(_as_text(study.table))
    return found


def refuse_other(plan: StudyPlan, out: Path) -> None:
    """Refuse to write over results that the study would not have.

    A file that has more runs than before may go on in the same folder.

    Raises:
        ValueError: If `out` holds finished results of another study, or something else.
    """
    if not (out / STUDY).exists():
        if taken := [
            name for name in (TABLE, CSV, EXPERIMENT, RECORD, "set.json", "capture.json") if (out / name).exists()
        ]:
            raise ValueError(f"{out} already holds {', '.join(taken)}, and no study wrote that: choose another --out")
        return
    before = read_json(out / STUDY, SHAPE)
    table = read_json(out / TABLE, ROWS) if (out / TABLE).exists() else {"axes": {}, "rows": []}
    # A table has its own axes: study.json may be newer, if it was killed in between.
    finished = [{name: row.get(name) for name in table["axes"]} for row in table["rows"] if row["state"] == "done"]
    if not finished:
        return
    now = jsonable_table(plan.study)
    parts = [
        part
        for part in ("preset", "override", "rig", "variant", "method")
        if before["table"].get(part) != now.get(part)
    ]
    remedy = "choose another --out, or add --overwrite"
    if parts:
        raise ValueError(f"{out} holds {len(finished)} finished runs of another study (it differs in "
                         f"{', '.join(parts)}): {remedy}")  # fmt: skip
    kept = [jsonable(cell.values) for cell, _ in plan.runs]
    if lost := [values for values in finished if values not in kept]:
        first = ", ".join(f"{name} {value}" for name, value in lost[0].items())
        raise ValueError(f"{out} holds {len(lost)} finished runs ({first}{', ...' * (len(lost) > 1)}) that "
                         f"{plan.study.path} does not have: {remedy}")  # fmt: skip


def again(plan: StudyPlan, out: Path, store: Path) -> str:
    """How many finished results in the table in `out` have to be made again, and why the first one; "" if none has."""
    rows = read_json(out / TABLE, ROWS)["rows"] if (out / TABLE).exists() else []
    before = {_values(plan, row): out / row["folder"] for row in rows if row["state"] == "done"}
    now = {_values(plan, jsonable(cell.values)): plan.tasks[key] for cell, key in plan.runs}
    record = RECORDS[plan.study.ends]
    other = [(before[values], task) for values, task in now.items()
             if values in before and before[values].name != task.name and (before[values] / record).exists()
             and not (task.folder(store) / SEAL).exists()]  # fmt: skip
    if not other:
        return ""
    folder, task = other[0]
    changed = made_with(folder, record).changed_in(code_of(*task.roots))
    why = from_request(read_json(folder / record, MADE).get("stage", {}), jsonable(task.config.resolved()), {})
    told = listed([*why, *([changed] if changed else [])]) or "their set or capture is made again"
    return f"{len(other)} of {len(before)}: {told}"


def _values(plan: StudyPlan, values: Mapping[str, Any]) -> str:
    return json.dumps([values.get(name) for name in plan.study.axes])


def _as_text(value: Any) -> Any:
    """Dates and times, which only TOML has, as text."""
    if isinstance(value, dict):
        return {key: _as_text(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_as_text(part) for part in value]
    return value if isinstance(value, str | int | float | bool) else str(value)
