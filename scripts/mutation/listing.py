"""All judged mutants as one page, each with the test that failed."""

import ast
import re
from collections import Counter
from collections.abc import Iterable
from typing import Any

CONTEXT = 24  # characters that are shown before and after the place where two texts differ


def listing(entries: Iterable[dict[str, Any]], notes: dict[str, str | None]) -> str:
    """A list for each kind, in Markdown.

    Args:
        entries: Verdicts.
        notes: Why a survivor changes nothing that matters, by its key; None where nobody wrote that down.
    """
    lines = list[str]()
    ordered = sorted(entries, key=lambda e: (e["kind"], e["file"], e["line"], e["after"]))
    for kind in dict.fromkeys(entry["kind"] for entry in ordered):
        lines += ["", f"## {kind.capitalize()}", ""]
        lines += [_line(entry, notes.get(entry["key"])) for entry in ordered if entry["kind"] == kind]
    return "\n".join(lines).strip() + "\n"


def listed(text: str) -> Counter[tuple[str, str, str]]:
    """The mutants that a list names, as files and both texts; lines of a source move and do not count.

    Some read alike: each text with how often the list has it.
    """
    return Counter(re.findall(r"^- (\S+):\d+ `([^`]*)` becomes `([^`]*)`;", text, re.M))


def _line(entry: dict[str, Any], why: str | None) -> str:
    before, after = difference(entry["before"], entry["after"])
    if entry["verdict"] == "survived":
        verdict = f"**survived**: {why or entry['by'] or 'to be caught'}"
    else:
        file, _, test = entry["by"].partition("::")
        verdict = f"{file.removeprefix('tests/')} `{test.partition('[')[0]}`" if test else entry["by"]
    return f"- {entry['file']}:{entry['line']} `{before}` becomes `{after}`; {verdict}"


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
