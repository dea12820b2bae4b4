"""Where the dB of runs are lost: the ladder of each that `novags explain` has looked at."""

from typing import Any

from novags.testbed.metrics.truth import ERROR
from novags.testbed.report.material import Material
from novags.testbed.report.parts import Page, Table, TableRow, heads, num
from novags.testbed.stages.explaining.ladder import explained


def explain(material: Material, page: Page) -> dict[str, Any] | None:
    """A table for each run; None where none was explained."""
    ladders = [
        {**found, "called": each.name, "table": table(found, number), "facts": list(found["not_swapped"].items())}
        for number, each in material.made.items()
        if (found := explained(each.run.path)) is not None
    ]
    return {"ladders": ladders} if ladders else None


def table(found: dict[str, Any], number: int) -> Table:
    """A row for each truth: what it wins back, and the standard error of that."""
    rows = [TableRow([step["swap"], step["truth"], num(step["won"]), num(step.get(f"won{ERROR}")), step["over"]])
            for step in found["steps"]]  # fmt: skip
    columns = heads("Ingredient | With its truth | #Won back [dB] | #Standard error [dB] | Over")
    return Table(f"explain-{number}", f"What each truth wins back of {found['run']}", columns, rows)
