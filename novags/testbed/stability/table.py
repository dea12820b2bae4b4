"""The table of hard cases: measured worst errors beside their bounds."""

from collections.abc import Iterable, Sequence

from novags.testbed.stability.case import Measured

BEGIN, END = "<!-- tables: novags doctor --stability --long --out -->", "<!-- end of tables -->"


def markdown(results: Iterable[Measured]) -> str:
    """A Markdown table a part; a row a case with the worst error of all its settings."""
    rows: dict[str, dict[str, list[Measured]]] = {}
    for result in results:
        rows.setdefault(result.case.part, {}).setdefault(result.case.name, []).append(result)
    parts = []
    for part, cases in rows.items():
        lines = [f"### {part}", "", "| case | worst error | bound | | computed by |", "|---|---|---|---|---|"]
        lines += [_row(found) for found in cases.values()]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def has_place(page: str) -> bool:
    """Whether a page has the lines between which tables belong."""
    return BEGIN in page and END in page.partition(BEGIN)[2]


def embedded(page: str, tables: str) -> str:
    """A page whose tables between the lines `BEGIN` and `END` are those of `tables`, part by part.

    Parts that were not computed keep their table. A page without these lines becomes `tables` alone.
    """
    head, begin, rest = page.partition(BEGIN)
    old, end, tail = rest.partition(END)
    if not (begin and end):
        return tables
    known, new = _by_part(old), _by_part(tables)
    parts = new if new.keys() >= known.keys() else known | new  # the order of a whole table is the right one
    return f"{head}{BEGIN}\n\n{''.join(parts.values())}{END}{tail}"


def _by_part(tables: str) -> dict[str, str]:
    """Each table with its heading, by the name of the part."""
    found = (f"### {text.strip()}\n\n" for text in tables.split("### ")[1:])
    return {text.splitlines()[0]: text for text in found}


def _row(found: Sequence[Measured]) -> str:
    case = found[0].case
    # NaN has no order: it counts as worst.
    worst = max((result.error for result in found), key=lambda error: (error != error, error))
    verdict = f"{worst:.2g}" if all(result.holds for result in found) else f"**{worst:.2g}**"
    backends = ", ".join(dict.fromkeys(result.setting.backend for result in found))
    return f"| {case.name} | {verdict} | {case.bound:.2g} | {case.unit} | {backends} |"
