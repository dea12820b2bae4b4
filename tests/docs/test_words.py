"""Pages that can be read: the first page is short, no page is long, and all together are a book and not a shelf."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
LONGEST, ALL, README = 1_800, 40_000, 900


def words(page: Path) -> int:
    """Tokens with a letter or a digit: prose, tables and code."""
    return sum(bool(re.search(r"[^\W_]", token)) for token in page.read_text(encoding="utf-8").split())


def test_the_first_page_is_read_in_minutes() -> None:
    assert words(ROOT / "README.md") <= README


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_page_is_long(page: Path) -> None:
    assert words(page) <= LONGEST


def test_all_pages_together_stay_a_book() -> None:
    assert sum(map(words, PAGES)) <= ALL


def test_a_word_has_a_letter_or_a_digit(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# One two\n\n| 3.5 ± 0.1 | — |\n|---|---|\n\n```\nfour `é` __\n```\n", encoding="utf-8")
    assert words(page) == 6
