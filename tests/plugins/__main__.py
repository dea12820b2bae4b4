"""Every plugin of Mitsuba: its plan against everything on, as a table.

    python -m tests.plugins                             # all, an hour on one core; goes on where it was
    python -m tests.plugins --plugin polarizer hair     # these again
    python -m tests.plugins --write docs/tables/what-mitsuba-plugins/plugins.csv

Results go to out/plugins/rows.jsonl, one line a scene; --write makes a table of them.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
import warnings
from pathlib import Path
from typing import Any

from tests.plugins.compare import Verdict, all_rows, judge, states
from tests.plugins.row import Row

RESULTS = Path("out/plugins/rows.jsonl")
HEAD = ["kind", "plugin", "planned", "differs from everything on by", "stated bound", "holds"]


def key(row: Row) -> str:
    """Names a scene in the results."""
    return f"{row.kind} {row.name}"


def line(row: Row, folder: Path) -> dict[str, Any]:
    """Judge one scene, or say why it is refused."""
    try:
        found: Verdict = judge(row, folder, measure=False)
    except ValueError as error:
        return {"row": key(row), "refused": str(error).rpartition("holds ")[2]}
    return {"row": key(row), "plan": states(found.plan), "change": found.change, "error": found.error,
            "bound": found.bound, "full": found.full, "holds": found.holds}  # fmt: skip


def table(results: dict[str, dict[str, Any]]) -> list[list[str]]:
    """The scenes that were judged, a row each."""
    lines = [HEAD]
    for row in all_rows():
        found = results.get(key(row))
        if found is None:
            continue
        start = [row.kind, row.name]
        if "refused" in found:
            lines.append([*start, f"refused: {found['refused']}", "", "", "yes"])
            continue
        change = f"{100 * found['change']:.2f} ± {100 * found['error']:.2f} %"
        bound = "unknown" if found["bound"] == float("inf") else f"{100 * found['bound']:.2f} %"
        lines.append([*start, found["plan"], change, bound, "yes" if found["holds"] else "no"])
    return lines


def main() -> None:
    """Judge what is missing; write the table if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plugin", nargs="*", default=(), help="judge these, whether they were before or not")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", type=Path, help="only write the table, as CSV")
    asked = parser.parse_args()
    asked.results.parent.mkdir(parents=True, exist_ok=True)
    texts = asked.results.read_text().splitlines() if asked.results.is_file() else []
    results = {found["row"]: found for found in map(json.loads, texts)}
    if asked.write is not None:
        with asked.write.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(table(results))
        return
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder, asked.results.open("a") as file:
        for row in all_rows():
            if row.plugin in asked.plugin or (not asked.plugin and key(row) not in results):
                found = line(row, Path(folder))
                file.write(json.dumps(found) + "\n")
                file.flush()
                print(found, flush=True)


if __name__ == "__main__":
    main()
