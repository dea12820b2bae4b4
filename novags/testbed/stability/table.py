"""The table of hard cases: measured worst errors beside their bounds."""

from collections.abc import Iterable, Sequence

from novags.testbed.stability.case import Measured


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


def _row(found: Sequence[Measured]) -> str:
    case = found[0].case
    # NaN has no order: it counts as worst.
    worst = max((result.error for result in found), key=lambda error: (error != error, error))
    verdict = f"{worst:.2g}" if all(result.holds for result in found) else f"**{worst:.2g}**"
    backends = ", ".join(dict.fromkeys(result.setting.backend for result in found))
    return f"| {case.name} | {verdict} | {case.bound:.2g} | {case.unit} | {backends} |"
