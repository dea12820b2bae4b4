"""Times as people write them."""

import pytest

from novags.testbed.study.budget.duration import seconds_of


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("120s", 120), ("120", 120), (" 2 min", 120), ("2.5m", 150), ("1h", 3600), ("1h30min", 5400), (".5s", 0.5),
     ("1H 1S", 3601)],
)  # fmt: skip
def test_a_time_is_so_many_seconds(text: str, seconds: float) -> None:
    assert seconds_of(text) == seconds


@pytest.mark.parametrize(
    "text",
    ["", "soon", "s", "-5s", "10 x", "1e3s", "0", "0s", "nan", "inf", "5s!", "9" * 400, "1h30", "2m5", "1 2", "1.5.5s"],
)  # fmt: skip
def test_what_is_no_time_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ValueError, match="a budget (is a time like 120s, 2min|must be more than no time)") as error:
        seconds_of(text)
    assert len(str(error.value)) < 200
