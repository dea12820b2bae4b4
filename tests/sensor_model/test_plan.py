"""Claims about the table of a plan."""

import pytest

from sensor_model.plan import Effect, Plan


def printed(*, on: bool = False, forced: bool = False, contribution: float = 0.001) -> tuple[str, str]:
    """The row and the last line of a plan of one effect that may cost 0.004."""
    effect = Effect(
        name="fog", on=on, forced=forced, contribution=contribution, bound=0.004, unit="of all light", reason="so"
    )
    _, row, last = str(Plan(effects=(effect,), bound=contribution, unit="of all light")).splitlines()
    return row, last


@pytest.mark.parametrize(
    ("on", "forced", "contribution", "mark"),
    [(False, False, 0.001, "off "), (False, False, 0.005, "off!"), (False, True, 0.005, "off*!"),
     (False, True, 0.001, "off*"), (True, True, 0.005, "on*"), (True, False, 0.005, "on ")],
)  # fmt: skip
def test_what_is_left_out_above_its_allowance_and_what_is_forced_is_marked_and_the_marks_are_explained(
    on: bool, forced: bool, contribution: float, mark: str
) -> None:
    row, last = printed(on=on, forced=forced, contribution=contribution)
    assert row.split("fog")[1].lstrip().startswith(mark.rstrip() + "  ")
    assert ("! left out above its allowance" in last) == ("!" in mark)
    assert ("* forced by name" in last) == ("*" in mark)
