"""The page of curves shows the curves that the package ships, and that budgets are made from."""

from pathlib import Path

from novags.testbed.report.curves.page import embedded
from novags.testbed.study.budget.known import SHIPPED
from novags.testbed.study.curves.curve import read_curves

PAGE = Path(__file__).parents[2] / "docs" / "accuracy-and-time.md"


def test_the_page_shows_what_is_shipped() -> None:
    page, points = PAGE.read_text(encoding="utf-8"), read_curves(SHIPPED)
    assert embedded(page, points) == page
    (first, *_) = points
    assert embedded(page, [{**first, "error": 0.123}]) != page
