"""No measured table is lost: each one of `measured.csv` stands in a page, or in a CSV file that a page links to.

Measured is a table in which a third of the cells have digits. Tables of curves and of hard cases are listed with the
heads that they have as one file: knob, setting, error; part, unit.
"""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
LISTED = Path(__file__).parent / "measured.csv"
Table = list[list[str]]


@pytest.fixture(scope="module")
def tables(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("choices/tables.py")


def columns(table: Table, head: Sequence[str]) -> list[int] | None:
    """Where the columns of a head stand in a table, which may have more; None where it lacks one."""
    found = list[int]()
    for name in head:
        place = next((i for i, other in enumerate(table[0]) if other == name and i not in found), None)
        if place is None:
            return None
        found.append(place)
    return found


def lost(listed: Sequence[dict[str, str]], there: Sequence[Table]) -> list[str]:
    """The listed tables that are nowhere. Of a table that several were joined to, each row counts once."""
    left = [len(table) - 1 for table in there]
    missing = []
    for one in listed:
        for number, table in enumerate(there):
            places = columns(table, one["head"].split(" | "))
            names = {row[places[0]] for row in table[1:]} if places else set()
            if int(one["rows"]) <= left[number] and {one["first row"], one["last row"]} <= names:
                left[number] -= int(one["rows"])
                break
        else:
            missing.append(f"{one['page']}, {one['heading']}: {one['head']}")
    return missing


def test_every_measured_table_is_in_a_page_or_in_a_csv_file_that_a_page_links_to(tables: ModuleType) -> None:
    names = [*sorted(DOCS.rglob("*.md")), ROOT / "README.md"]
    pages = [path.read_text(encoding="utf-8") for path in names]
    there = [table for page in pages for table in tables.tables_of(page)]
    for path in sorted((DOCS / "tables").rglob("*.csv")):
        if any(f"]({path.relative_to(DOCS).as_posix()})" in page for page in pages):
            there.append(tables.read_csv(path))
    with LISTED.open(encoding="utf-8", newline="") as file:
        listed = list(csv.DictReader(file))
    assert len(listed) > 100
    assert lost(listed, there) == []


def test_every_csv_file_of_a_table_is_linked_and_has_rows_as_long_as_its_head(tables: ModuleType) -> None:
    pages = "".join(path.read_text(encoding="utf-8") for path in DOCS.glob("*.md"))
    for path in sorted((DOCS / "tables").rglob("*.csv")):
        assert f"]({path.relative_to(DOCS).as_posix()})" in pages, path
        assert {len(row) for row in tables.read_csv(path)} == {len(tables.read_csv(path)[0])}, path


ONE = {"page": "a.md", "heading": "A", "head": "case | dB", "rows": "2", "first row": "x", "last row": "y"}


@pytest.mark.parametrize(
    ("there", "holds"),
    [
        ([["case", "dB"], ["x", "1"], ["y", "2"]], True),
        ([["scene", "case", "more", "dB"], ["s", "x", "", "1"], ["s", "y", "", "2"]], True),  # joined with others
        ([["case", "dB"], ["x", "1"], ["z", "2"]], False),
        ([["case", "dB"], ["x", "1"]], False),
        ([["case", "SSIM"], ["x", "1"], ["y", "2"]], False),
    ],
)
def test_a_table_with_another_head_fewer_rows_or_other_names_is_lost(there: Table, holds: bool) -> None:
    assert (lost([ONE], [there]) == []) is holds
    assert lost([ONE, ONE], [there])  # one table does not stand for two


def test_a_table_becomes_a_file_and_a_link(tables: ModuleType, tmp_path: Path) -> None:
    first = "| a | b |\n|---|--:|\n| `x` | **1** |\n| [y](z.md) | 2 \\| 3 |\n"
    text = f"2 runs, dB:\n\n{first}\nSSIM:\n\n| a |\n|---|\n| x |\n"
    made = tables.as_csv(text, tmp_path / "page.md", "study")
    assert made == (
        "2 runs, dB:\n\n[2 rows as CSV](tables/page/study-1.csv)\n\nSSIM:\n\n[1 rows as CSV](tables/page/study-2.csv)\n"
    )
    assert tables.read_csv(tmp_path / "tables/page/study-1.csv") == [["a", "b"], ["x", "1"], ["y", "2 | 3"]]
