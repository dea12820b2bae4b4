"""The page of curves and its tables show the curves that the package ships, and that budgets are made from."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from novags.testbed.report.curves.page import embedded
from novags.testbed.report.curves.table import joined
from novags.testbed.study.budget.known import SHIPPED
from novags.testbed.study.curves.curve import read_curves

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "accuracy-and-time.md"


def test_the_page_shows_what_is_shipped() -> None:
    page, points = PAGE.read_text(encoding="utf-8"), read_curves(SHIPPED)
    assert embedded(page, points) == page
    (first, *_) = (point for point in points if point["default"])
    assert embedded(page, [{**first, "repeats": 77}]) != page


def test_the_tables_of_all_settings_are_those_that_are_shipped(script: Callable[[str], ModuleType]) -> None:
    tables = script("choices/tables.py")
    points = read_curves(SHIPPED)
    names = list(dict.fromkeys(point["knob"].partition(".")[0] for point in points))
    folder = ROOT / "docs" / "tables" / PAGE.stem
    assert {f"{name}.csv" for name in names} <= {path.name for path in folder.iterdir()}
    for name in names:
        own = [point for point in points if point["knob"].startswith(f"{name}.")]
        assert tables.read_csv(folder / f"{name}.csv") == joined(own), "run python scripts/make_docs.py --cheap"
