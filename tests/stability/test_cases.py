"""Claims about the hard cases as such: what fails, what is refused, and what their table shows."""

import csv
import importlib
import math
from pathlib import Path

import pytest

from tests.stability.case import Case, available, refusal, worse

HERE = Path(__file__).resolve().parent
TABLE = HERE.parents[1] / "docs" / "tables" / "stability" / "cases.csv"
FILE = """
from tests.stability.case import Part

PART = Part("made_up")


@PART.case("a case", bound=1e-3, unit="relative")
def _(setting):
    return {errors}[setting.threads - 1]


def test_the_error_stays_within_its_bound(case, setting, error):
    assert error(case, setting) <= case.bound
"""


def run(pytester: pytest.Pytester, errors: str) -> tuple[dict[str, int], str]:
    """How the two settings of a case with these errors end, and the table that takes them."""
    pytester.makeconftest("from tests.stability.conftest import *")
    pytester.makepyfile(FILE.format(errors=errors))
    table = pytester.path / "cases.csv"
    table.write_text("part,case\nmade_up,old\nanother,old\n")
    done = pytester.runpytest_inprocess("--hard-cases", table, "-p", "no:cacheprovider")
    return done.parseoutcomes(), table.read_text()


@pytest.mark.parametrize("error", ["float('nan')", "float('inf')", "2e-3"])
def test_an_error_that_is_no_number_or_too_large_fails_and_leaves_the_table(
    pytester: pytest.Pytester, error: str
) -> None:
    outcome, table = run(pytester, f"[1e-4, {error}]")
    assert (outcome["passed"], outcome["failed"]) == (1, 1)
    assert table.count("old\n") == 2


def test_an_error_at_the_bound_holds_and_the_table_shows_the_worst_setting(pytester: pytest.Pytester) -> None:
    outcome, table = run(pytester, "[1e-4, 1e-3]")
    assert outcome["passed"] == 2
    assert table == (
        "part,case,worst error,bound,unit,computed by\nmade_up,a case,0.001,0.001,relative,torch\nanother,old\n"
    )


def cases() -> dict[str, list[Case]]:
    """The cases of every file here, by part."""
    names = [".".join(path.relative_to(HERE.parents[1]).with_suffix("").parts) for path in HERE.rglob("test_*.py")]
    parts = [module.PART for module in map(importlib.import_module, sorted(names)) if hasattr(module, "PART")]
    return {part.name: part.cases for part in parts}


def test_the_table_has_every_case_with_its_bound() -> None:
    """`python scripts/make_docs.py docs/stability.md` makes it anew."""
    found: dict[str, list[tuple[str, str, str]]] = {}
    with TABLE.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(row["part"], []).append((row["case"], row["bound"], row["unit"]))
    assert found == {
        part: [(case.name, f"{case.bound:.2g}", case.unit) for case in cases] for part, cases in cases().items()
    }


def fail(error: Exception) -> None:
    raise error


def test_a_refusal_is_a_value_error_of_one_line_with_the_words_expected() -> None:
    assert refusal(lambda: fail(ValueError("depth must be positive")), "depth") == 0
    assert refusal(lambda: fail(ValueError("depth must be positive")), "width") == math.inf
    assert refusal(lambda: fail(ValueError("depth\nmust be positive")), "depth") == math.inf
    assert refusal(lambda: None) == math.inf


def test_an_error_that_is_nan_is_never_lost_among_others() -> None:
    assert math.isnan(worse(0.0, math.nan))
    assert math.isnan(worse(math.nan, 1.0))
    assert worse(0.5, 2.0, 1.0) == 2.0


def test_a_backend_that_is_not_here_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr("tests.stability.case.backend_status", lambda name: (asked.append(name), (False, "none"))[1])
    assert not available("llvm_ad_rgb")
    assert asked == ["llvm_ad"]
    assert available("numpy")
