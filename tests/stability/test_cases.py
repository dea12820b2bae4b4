import math

import pytest

from novags.testbed.stability import Case, Part, Setting, embedded, markdown, measured, refusal
from novags.testbed.stability.case import available, worse
from novags.testbed.stability.table import BEGIN, END

HERE = Setting("torch", 1)


def case_that(measure, bound: float = 1e-3) -> Case:
    part = Part("part")
    part.case("a case", bound=bound, unit="relative")(measure)
    return part.cases[0]


@pytest.mark.parametrize("error", [math.nan, math.inf, 2e-3])
def test_errors_that_are_no_numbers_or_too_large_do_not_hold(error: float) -> None:
    assert not measured(case_that(lambda setting: error), HERE).holds


def test_an_error_at_the_bound_holds() -> None:
    assert measured(case_that(lambda setting: 1e-3), HERE).holds


def test_an_exception_counts_as_an_infinite_error_and_is_named() -> None:
    found = measured(case_that(lambda setting: 1 / 0), HERE)
    assert found.error == math.inf
    assert "ZeroDivisionError" in str(found)


def fail(error: Exception) -> None:
    raise error


def test_a_refusal_is_a_value_error_of_one_line_with_the_words_expected() -> None:
    assert refusal(lambda: fail(ValueError("depth must be positive")), "depth") == 0
    assert refusal(lambda: fail(ValueError("depth must be positive")), "width") == math.inf
    assert refusal(lambda: fail(ValueError("depth\nmust be positive")), "depth") == math.inf
    assert refusal(lambda: None) == math.inf


def test_the_table_shows_the_worst_setting_and_marks_what_does_not_hold() -> None:
    case = case_that(lambda setting: {1: 1e-4, 2: 5e-3}[setting.threads])
    row = markdown([measured(case, setting) for setting in case.settings()]).splitlines()[-1]
    assert row == "| a case | **0.005** | 0.001 | relative | torch |"


def test_new_tables_replace_the_old_ones_of_their_parts_and_nothing_else() -> None:
    page = f"# Page\n\n{BEGIN}\n\n### a\n\nold a\n\n### b\n\nold b\n\n{END}\n\nText.\n"
    again = embedded(page, "### b\n\nnew b\n\n### c\n\nnew c\n")
    assert again == f"# Page\n\n{BEGIN}\n\n### a\n\nold a\n\n### b\n\nnew b\n\n### c\n\nnew c\n\n{END}\n\nText.\n"
    assert embedded(again, "### b\n\nnew b\n") == again
    assert embedded("", "### a\n") == "### a\n"


def test_an_error_that_is_nan_is_never_lost_among_others() -> None:
    assert math.isnan(worse(0.0, math.nan))
    assert math.isnan(worse(math.nan, 1.0))
    assert worse(0.5, 2.0, 1.0) == 2.0


def test_a_backend_that_is_not_here_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr("simscenes.backend.backend_status", lambda name: (asked.append(name), (False, "none"))[1])
    assert not available("llvm_ad_rgb")
    assert asked == ["llvm_ad"]
    assert available("numpy")
