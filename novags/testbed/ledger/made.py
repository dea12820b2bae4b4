"""With which code a result was made, file by file, so that it can be said why it is made again.

This lies beside the record, hidden, so that it is part of no digest and of no copy for others: `.run.json` for
`run.json`. The key in the record decides; this explains.
"""

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from novags.testbed.ledger.code import Code
from novags.testbed.ledger.contents import read_json, write_json

SHAPE = {"date": str, "code": {"*": str}, "texts": {"*": str}}
SHOWN = 2  # files that are named


@dataclass(frozen=True)
class MadeWith:
    """With which code a result was made; empty where that is not known."""

    date: str = ""
    files: dict[str, str] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)

    def changed_in(self, code: Code) -> str:
        """Its changed parts, in words; "" if there are none."""
        if not self.files:
            return "its code is not known"
        names = {*self.files, *code.files}
        changed = sorted(name for name in names if self.files.get(name) != code.files.get(name))
        return f"{_named(changed)} changed since {_day(self.date)}" if changed else ""

    def kept_though(self, code: Code) -> str:
        """What to add to "kept" where texts changed alone (comments, docstrings, messages), or code it does not use."""
        changed = sorted(name for name in self.texts if self.texts[name] != code.texts.get(name))
        said = f": only texts, or code it does not use, changed in {_named(changed).rpartition(' ')[0]}"
        return said if changed else ""


def made_name(record_name: str) -> str:
    """The file beside a record."""
    return f".{record_name}"


def made_with(folder: Path, record_name: str) -> MadeWith:
    """With which code a result was made."""
    try:
        found = read_json(folder / made_name(record_name), SHAPE)
    except ValueError:  # of an earlier version, or lost in a copy: nothing depends on it
        return MadeWith()
    return MadeWith(found["date"], found["code"], found["texts"])


def write_made(folder: Path, record_name: str, code: Code) -> None:
    """State with which code a result is made."""
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    write_json(folder / made_name(record_name), {"date": now, "code": code.files, "texts": code.texts})


def _named(files: list[str]) -> str:
    """A few of the files, and the verb that follows."""
    more = len(files) - SHOWN
    names = ", ".join(files[:SHOWN]) + (f" and {more} more" if more > 0 else "")
    return f"{names} {'has' if len(files) == 1 else 'have'}"


def _day(date: str) -> str:
    try:
        day = datetime.fromisoformat(date)
    except ValueError:
        return "then"
    year = "" if day.year == datetime.now().year else f" {day.year}"
    return f"{day.day} {day:%B}{year}, {day:%H:%M}"
