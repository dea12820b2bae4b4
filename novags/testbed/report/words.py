"""Numbers and lists in the words of a report."""

from typing import Any

from markupsafe import Markup

from novags.testbed.report.rows import Row


def join(words: list[str]) -> str:
    """'a', 'a and b', 'a, b and c'."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def number(value: float | str | None, digits: int = 2) -> str:
    """A number for a table; None becomes 'unavailable'."""
    if value is None:
        return "unavailable"
    if isinstance(value, str):
        return value
    shown = f"{value:.{digits}f}"
    return shown.removeprefix("-") if not float(shown) else shown  # no "-0.00"


def signed(value: float) -> str:
    """A number with its sign, with a true minus sign."""
    return f"{value:+.2f}".replace("-", "−")


def share(value: float, error: float | None = None) -> str:
    """A part of a whole in per cent, with its standard error if that is known."""
    return f"{100 * value:.0f}{'' if error is None else f' ± {100 * error:.0f}'} %".replace("-", "−")


def duration(seconds: float) -> str:
    """A duration in readable units."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def size(count: int) -> str:
    """Bytes in MB or GB."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def named(row: Row) -> Any:
    """The name of a run or a method with the dot of its colour, and a dagger where it sees truth."""
    dagger = "" if row.competes else Markup('<span class="dagger" title="sees truth: a bound, not a rival">†</span>')
    return Markup('<span class="dot {}" aria-hidden="true"></span>{}{}').format(row.key, row.name, dagger)
