"""The runs of a study, one line for each combination but the seed, and which method comes first where."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from novags.testbed.metrics import METRICS
from novags.testbed.report.tables import is_plain, measured, ranks, spread_of
from novags.testbed.report.words import join
from novags.testbed.study.cells.grid import spelled
from novags.testbed.study.light import METHOD, SEED

Row = Mapping[str, Any]
CAPTURE = "capture"  # the axis of runs that no study made
# column of the study's table, heading, unit, whether more is better, digits
_FIRST = (("enhanced.aligned_psnr", "PSNR aligned, noise-free", "dB", True, 2),)
_REST = (
    ("linear.linear_psnr", "PSNR linear", "dB", True, 2),
    ("enhanced.flip", "FLIP, noise-free", "", False, 3),
    ("over.enhanced", "Over the floor", "dB", True, 2),
    ("over.lit", "Over the floor, lit", "dB", True, 2),
    ("recovered", "Recovered", "", True, 2),
    ("recovered_lit", "Recovered, lit", "", True, 2),
    ("geometry.abs_rel", "Depth error", "", False, 3),
    ("cameras.registered_share", "Views with a camera", "", True, 2),
    ("seconds.reconstruct", "Reconstruction", "s", False, 1),
    ("peak_bytes", "Peak memory", "MB", False, 0),
)
MAIN = ("enhanced.aligned_psnr", "lit.tone_aligned_psnr")  # of which one decides
# Those order as MAIN does; costs.
SILENT = ("over.enhanced", "over.lit", "recovered", "recovered_lit", "seconds.reconstruct", "peak_bytes")
OWN = ("enhanced.flip", "enhanced.aligned_psnr", "over.enhanced", "recovered")  # compare with a method's own reference
LINEAR = "linear"  # begins the columns that methods have which end in linear light; of photographs they hold no value
SCALES = {"peak_bytes": 1e-6}


def columns() -> tuple[tuple[str, str, str, bool, int], ...]:
    """The columns, with those of the scores of pictures against the well-lit ones."""
    lit = ((f"lit.{name}", f"{metric.heading}, lit", metric.unit, metric.more, metric.digits)
           for name, metric in METRICS.items() if metric.in_studies)  # fmt: skip
    return (*_FIRST, *lit, *_REST)


def is_helped(column: str) -> bool:
    """Whether the truth helps a score of linear light, because it decides the exposure and nothing is aligned."""
    reference, _, name = column.partition(".")
    return reference == "lit" and is_plain(name)


@dataclass
class Line:
    """The runs that differ in their seed alone."""

    place: dict[str, Any]  # values of the axes but method and seed
    method: str
    runs: list[Row]  # its rows of the study's table
    # Mean and standard deviation over the seeds (None of fewer than two) by column, where there are values.
    spread: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    places: dict[str, int] = field(default_factory=dict)  # its rank among competing lines at the same place, by column
    alike: bool = True  # whether references at this place are enhanced alike: else scores against them rank nothing

    @property
    def where(self) -> str:
        """What a page calls its place."""
        return str(self.place[CAPTURE]) if [*self.place] == [CAPTURE] else spelled(self.place) or "all runs"

    @property
    def in_linear_light(self) -> bool:
        """Whether the method ends in linear light, which truth brings to the exposure of the well-lit pictures."""
        return any(column.partition(".")[0] == LINEAR for row in self.runs for column in row)


def lines_of(
    rows: Sequence[Row], axes: Mapping[str, Any], competes: Mapping[str, bool],
    enhancements: Mapping[int, str] | None = None,
) -> list[Line]:  # fmt: skip
    """One line for each combination of all axes but the seed of a study's table, best first at each place.

    `competes`: whether a method may be the best, by name; `enhancements`: what the noise-free pictures of each run are
    enhanced by, by number of the row, where known.
    """
    others = [name for name in axes if name not in (METHOD, SEED)]
    groups: dict[tuple[Any, ...], Line] = {}
    for row in rows:
        place = {name: row[name] for name in others}
        key = (*map(str, place.values()), row[METHOD])
        groups.setdefault(key, Line(place, str(row[METHOD]), [])).runs.append(row)
    for line in groups.values():
        for column, *_ in columns():
            values = [value for row in line.runs if (value := _value(row, column)) is not None]
            if values:
                over = spread_of(values, True)
                line.spread[column] = (float(over["mean"] or 0.0), over["sd"])
    found = []
    for members in by_place(list(groups.values())).values():
        numbers = [row["run"] for line in members for row in line.runs if "run" in row]
        alike = len({(enhancements or {}).get(number) for number in numbers} - {None}) <= 1
        for line in members:
            line.alike = alike
        for column, _, _, more, _ in columns():
            known = {line.method: line.spread[column][0] for line in members
                     if column in line.spread and competes[line.method] and (alike or column not in OWN)
                     and not (is_helped(column) and line.in_linear_light)}  # fmt: skip
            for name, rank in ranks(known, more).items():
                next(line for line in members if line.method == name).places[column] = rank
        found += sorted(members, key=_main)
    return found


def by_place(lines: Sequence[Line]) -> dict[tuple[str, ...], list[Line]]:
    """The lines of each place."""
    found: dict[tuple[str, ...], list[Line]] = {}
    for line in lines:
        found.setdefault(tuple(map(str, line.place.values())), []).append(line)
    return found


def shown_columns(lines: Sequence[Line]) -> list[tuple[str, str, str, bool, int]]:
    """The columns that have a value."""
    return [column for column in columns() if any(column[0] in line.spread for line in lines)]


def main_column(lines: Sequence[Line]) -> str | None:
    """The score that decides: against the noise-free exposure where all share one, else against the well-lit render."""
    done = [line for line in lines if line.spread]
    known = [column for column in MAIN if done and all(column in line.spread for line in done)]
    return known[-1] if not all(line.alike for line in done) and known else next(iter(known), None)


def verdict(lines: Sequence[Line], competes: Mapping[str, bool]) -> str:
    """How often which method comes first, by the main score and by all others that disagree."""
    if (main := main_column(lines)) is None:
        return "No score is known of all runs, so no method comes first."
    if not any(competes[line.method] for line in lines):
        return "Only methods that see truth were run."
    headings = {column: heading for column, heading, *_ in columns()}
    found = first_places(lines, main)
    if not found:
        return f"Nowhere do two methods that see no truth compete by {headings[main]}, so none comes first."
    best = next(iter(found))
    others = [f"{name} in {times}" for name, times in found.items() if name != best]
    rest = f"; {join(others)}" if others else ""
    text = f"{best} comes first in {found[best]} of {sum(found.values())} comparisons by {headings[main]}{rest}."
    return text + _dissent(lines, main, best)


def _dissent(lines: Sequence[Line], main: str, best: str) -> str:
    """By which other scores another method comes first; scores in which the best takes no place say nothing of it."""
    apart: dict[str, list[str]] = {}
    for column, heading, *_ in columns():
        placed = any(column in line.places for line in lines if line.method == best)
        found = first_places(lines, column) if placed and column not in (main, *SILENT) else {}
        winner = next(iter(found), best)
        if winner != best:
            said = f"{winner} comes first in {found[winner]} of {sum(found.values())}, {best} in {found.get(best, 0)}"
            apart.setdefault(said, []).append(heading)
    return "".join(f" Not so by {'; '.join(scores)}: there {said}." for said, scores in apart.items())


def first_places(lines: Sequence[Line], column: str) -> dict[str, int]:
    """How often each method comes first by a column, most often first; places with one rival do not count."""
    found: dict[str, int] = {}
    for members in by_place(lines).values():
        placed = [line for line in members if column in line.places]
        if len(placed) > 1:
            winner = min(placed, key=lambda line: line.places[column]).method
            found[winner] = found.get(winner, 0) + 1
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _value(row: Row, column: str) -> float | None:
    value = measured(row.get(column)) if row["state"] == "done" else None
    return None if value is None else value * SCALES.get(column, 1.0)


def _main(line: Line) -> tuple[bool, float]:
    order = MAIN if line.alike else MAIN[::-1]
    found = next((line.spread[column][0] for column in order if column in line.spread), None)
    return found is None, -(found or 0.0)
