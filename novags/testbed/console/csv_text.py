"""Tables as CSV that spreadsheets open without running anything in them, and cells read back."""

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

MARK = "'"  # what spreadsheets take for "this is text"
# Beginnings of formulas, and characters that spreadsheets take for one.
FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


def as_csv(rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None) -> str:
    """Rows as CSV; an empty cell is a value that there is not.

    Args:
        rows: Values by column.
        columns: In this order; None: in the order of their first appearance.
    """
    names = list(dict.fromkeys(name for row in rows for name in row)) if columns is None else columns
    return "".join(map(_line, [names, *([row.get(name) for name in names] for row in rows)]))


def _line(values: Sequence[Any]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\r\n").writerow(map(_cell, values))  # so that both are quoted in a cell
    return text.getvalue()[:-2] + "\n"


def _cell(value: Any) -> Any:
    """A value; text that a spreadsheet would compute is marked, and so is text that begins with the mark: see
    `text_of`.
    """
    if not isinstance(value, str) or not value.startswith((MARK, *FORMULA)) or _is_number(value):
        return value
    return MARK + value


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def text_of(cell: str) -> str:
    """The text of a cell that `as_csv` wrote."""
    return cell.removeprefix(MARK)
