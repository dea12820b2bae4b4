"""Claims about the hard cases as such: what fails, what is refused, and what their page shows."""

import math

import pytest

from tests.stability.case import available, refusal, worse

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
    """How the two settings of a case with these errors end, and the page that takes them."""
    pytester.makeconftest("from tests.stability.conftest import *")
    pytester.makepyfile(FILE.format(errors=errors))
    page = pytester.path / "page.md"
    page.write_text("# Page\n\n## Measured\n\nold\n")
    done = pytester.runpytest_inprocess("--hard-cases", page, "-p", "no:cacheprovider")
    return done.parseoutcomes(), page.read_text()


@pytest.mark.parametrize("error", ["float('nan')", "float('inf')", "2e-3"])
def test_an_error_that_is_no_number_or_too_large_fails_and_leaves_the_page(
    pytester: pytest.Pytester, error: str
) -> None:
    outcome, page = run(pytester, f"[1e-4, {error}]")
    assert (outcome["passed"], outcome["failed"]) == (1, 1)
    assert page.endswith("old\n")


def test_an_error_at_the_bound_holds_and_the_page_shows_the_worst_setting(pytester: pytest.Pytester) -> None:
    outcome, page = run(pytester, "[1e-4, 1e-3]")
    assert outcome["passed"] == 2
    assert page.startswith("# Page\n\n## Measured\n\n### made_up\n\n")
    assert page.splitlines()[-1] == "| a case | 0.001 | 0.001 | relative | torch |"


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
