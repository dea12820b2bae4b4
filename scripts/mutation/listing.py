"""All judged mutants as one table, each with the test that failed."""

import ast
import csv
import io
from collections import Counter
from collections.abc import Iterable
from typing import Any

HEAD = ("kind", "place", "before", "after", "verdict")
CONTEXT = 24  # characters that are shown before and after the place where two texts differ


def listing(entries: Iterable[dict[str, Any]], notes: dict[str, str | None]) -> str:
    """A row for each mutant, as CSV.

    Args:
        entries: Verdicts.
        notes: Why a survivor changes nothing that matters, by its key; None where nobody wrote that down.
    """
    ordered = sorted(entries, key=lambda e: (e["kind"], e["file"], e["line"], e["after"]))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([HEAD, *(_row(e, notes.get(e["key"])) for e in ordered)])
    return text.getvalue()


def listed(text: str) -> Counter[tuple[str, str, str]]:
    """The mutants that a list names, as files and both texts; lines of a source move and do not count.

    Some read alike: each text with how often the list has it.
    """
    rows = csv.DictReader(io.StringIO(text, newline=""))
    return Counter((row["place"].rpartition(":")[0], row["before"], row["after"]) for row in rows)


def _row(entry: dict[str, Any], why: str | None) -> tuple[str, ...]:
    before, after = difference(entry["before"], entry["after"])
    if entry["verdict"] == "survived":
        verdict = f"survived: {why or entry['by'] or 'to be caught'}"
    else:
        file, _, test = entry["by"].partition("::")
        verdict = f"{file.removeprefix('tests/')} {test.partition('[')[0]}" if test else entry["by"]
    return entry["kind"], f"{entry['file']}:{entry['line']}", before, after, verdict


def difference(before: str, after: str) -> tuple[str, str]:
    """Both texts around the place where they differ, laid out alike."""
    one, other = (_laid_out(text) for text in (before, after))
    shortest = min(len(one), len(other))
    head = next((i for i in range(shortest) if one[i] != other[i]), shortest)
    tail = next((i for i in range(shortest - head) if one[-1 - i] != other[-1 - i]), shortest - head)
    start, stop = max(0, head - CONTEXT), max(0, tail - CONTEXT)
    return tuple(  # type: ignore[return-value]
        ("…" if start else "") + text[start : len(text) - stop] + ("…" if stop else "") for text in (one, other)
    )


def _laid_out(text: str) -> str:
    try:
        return ast.unparse(ast.parse(f"({text}\n)"))  # an expression may take several lines
    except SyntaxError:
        return ast.unparse(ast.parse(text.strip()))
