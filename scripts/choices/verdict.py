"""What the finished runs of a study say about each alternative: differences to the base, who goes on, the table."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

OWN, LIT = "enhanced.aligned_psnr", "lit.tone_aligned_psnr"
SECONDS = "seconds.reconstruct"
LEAST = 0.05  # dB; a smaller difference does not count, however certain it is


@dataclass(frozen=True)
class Finding:
    """One alternative beside the base.

    Attributes:
        name: CHOICE.ALTERNATIVE.
        settings: Its changes.
        own: Differences in aligned PSNR against the noise-free exposure through the enhancement of each run, dB.
        lit: Differences in tone-aligned PSNR against the well-lit truth, dB, at the same places.
        cost: Seconds of training and rendering, as a multiple of the base's, geometric mean.
        failed: Why a run of it failed; None if none did.
    """

    name: str
    settings: Mapping[str, Any]
    own: tuple[float, ...]
    lit: tuple[float, ...]
    cost: float | None
    failed: str | None = None

    @property
    def choice(self) -> str:
        """What is chosen."""
        return self.name.partition(".")[0]

    @property
    def deciding(self) -> tuple[float, ...]:
        """The differences that count: another enhancement is another reference, so only the lit truth is common."""
        return self.lit if any(key.partition(".")[0] == "enhance" for key in self.settings) else self.own


def findings(
    rows: Iterable[Mapping[str, Any]], axes: Sequence[str], table: Mapping[str, Any], base: str
) -> list[Finding]:
    """The results of each variant that is an alternative, in the order of the study file.

    Args:
        rows: Of the study's results.json.
        axes: Names of its axes.
        table: The study file.
        base: The variant that the others are compared with, run by run at the same place.
    """
    runs: dict[str, dict[tuple[Any, ...], Mapping[str, Any]]] = {}
    for row in rows:
        place = tuple(row[axis] for axis in axes if axis != "method")
        runs.setdefault(row["method"], {})[place] = row
    found = []
    for name, settings in table["variant"].items():
        if "." in name and name in runs:
            found.append(_finding(name, settings, runs[name], runs.get(base, {})))
    return found


def _finding(
    name: str, settings: Mapping[str, Any], runs: Mapping[tuple[Any, ...], Mapping[str, Any]],
    base: Mapping[tuple[Any, ...], Mapping[str, Any]],
) -> Finding:  # fmt: skip
    pairs = [(row, base[place]) for place, row in runs.items()
             if _scored(row) and _scored(base.get(place, {}))]  # fmt: skip
    ratios = [math.log(row[SECONDS] / other[SECONDS]) for row, other in pairs]
    return Finding(
        name=name,
        settings={key: value for key, value in settings.items() if key != "method"},
        own=tuple(row[OWN] - other[OWN] for row, other in pairs),
        lit=tuple(row[LIT] - other[LIT] for row, other in pairs),
        cost=math.exp(sum(ratios) / len(ratios)) if ratios else None,
        failed=next((row["reason"] for row in runs.values() if row["state"] == "failed"), None),
    )


def _scored(row: Mapping[str, Any]) -> bool:
    return row.get("state") == "done" and None not in (row[OWN], row[LIT])


def going_on(found: Sequence[Finding]) -> list[str]:
    """The better half of the alternatives by their mean difference, in their order; failed ones stay behind."""
    known = [f for f in found if f.deciding and f.failed is None]
    ranked = sorted(known, key=lambda f: -_mean(f.deciding))
    kept = {f.name for f in ranked[: math.ceil(len(ranked) / 2)]}
    return [f.name for f in found if f.name in kept]


def decision(finding: Finding, runs_in_all: int, gone_on: bool) -> str:
    """What follows from the differences, in a few words.

    Args:
        finding: The alternative.
        runs_in_all: How many pairs the last rung has.
        gone_on: Whether it is, or will be, in the next rung.
    """
    values = finding.deciding
    if finding.failed is not None:
        return "failed"
    if not values:
        return "not run"
    if len(values) < runs_in_all:
        return "open" if gone_on else f"dropped (n = {len(values)})"
    mean, error = _mean(values), _standard_error(values)
    if abs(mean) < max(LEAST, 2 * error):
        return "no difference"
    return "better" if mean > 0 else "worse"


def markdown(found: Sequence[Finding], runs_in_all: int, kept: Iterable[str]) -> str:
    """The table of a page."""
    on = set(kept)
    head = (
        "| choice | setting | n | own reference, dB | well lit, dB | cost | decision |\n"
        "| --- | --- | ---: | --- | --- | ---: | --- |\n"
    )
    lines = []
    for f in found:
        settings = ", ".join(f"`{key} = {_as_typed(value)}`" for key, value in f.settings.items())
        cost = "" if f.cost is None else f"× {f.cost:.2f}"
        own, lit = (_spread(values) for values in (f.own, f.lit))
        own, lit = (own, f"**{lit}**") if f.deciding is f.lit else (f"**{own}**", lit)
        verdict = decision(f, runs_in_all, f.name in on)
        lines.append(f"| {f.choice} | {settings} | {len(f.own)} | {own} | {lit} | {cost} | {verdict} |\n")
    return head + "".join(lines)


def _as_typed(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _spread(values: Sequence[float]) -> str:
    if not values:
        return "–"
    if len(values) == 1:
        return f"{values[0]:+.2f}"
    return f"{_mean(values):+.2f} ({min(values):+.2f} to {max(values):+.2f})"


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _standard_error(values: Sequence[float]) -> float:
    mean = _mean(values)
    return math.sqrt(sum((value - mean) ** 2 for value in values) / max(1, len(values) - 1) / len(values))
