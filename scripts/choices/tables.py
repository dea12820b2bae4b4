"""Tables of the pages: Markdown as rows of cells, and long ones as CSV files below docs/tables."""

import csv
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

BLOCK = re.compile(r"(?:^\|.*\n?)+", re.M)  # lines of one table
CODE = re.compile(r"^```.*?^```$", re.M | re.S)


def cells(line: str) -> list[str]:
    """The cells of a line as plain text: no code marks, no bold, no targets of links."""
    parts = [part.strip().replace(r"\|", "|") for part in re.split(r"(?<!\\)\|", line.strip().strip("|"))]
    return [re.sub(r"\[(.*?)\]\(.*?\)|(?<!\w)\*\*(.+?)\*\*(?!\w)|`", r"\1\2", part) for part in parts]


def rows(table: str) -> list[list[str]]:
    """The head and the rows of one table."""
    head, _, *body = table.strip().splitlines()
    return [cells(line) for line in (head, *body)]


def tables_of(text: str) -> list[list[list[str]]]:
    """All tables of a page."""
    return [rows(found[0]) for found in BLOCK.finditer(CODE.sub("", text)) if found[0].count("\n") > 1]


def write_csv(path: Path, table: Iterable[Sequence[str]]) -> None:
    """Write the head and the rows of a table."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(table)


def read_csv(path: Path) -> list[list[str]]:
    """The head and the rows of a table."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def as_csv(text: str, page: Path, name: str) -> str:
    """The text for a page, with a link in the place of each table, which goes to docs/tables/PAGE/NAME.csv."""
    found = list(BLOCK.finditer(text))
    for number, block in reversed(list(enumerate(found, 1))):
        file = Path("tables") / page.stem / (f"{name}-{number}.csv" if len(found) > 1 else f"{name}.csv")
        table = rows(block[0])
        write_csv(page.parent / file, table)
        text = f"{text[: block.start()]}[{len(table) - 1} rows as CSV]({file.as_posix()})\n{text[block.end() :]}"
    return text
