"""The runs of a study, one line for each combination but the seed, and which method comes first where."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isclose
from statistics import fmean
from typing import Any

from novags.testbed.metrics import METRICS
from novags.testbed.metrics.differences import Estimate, Values, difference, order, places
from novags.testbed.report.tables import is_plain, measured, spread_of
from novags.testbed.report.words import join, signed
from novags.testbed.stages.scores.comparing import SHARES, values_of
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
# Of these columns the values of another say whether they differ.
DERIVED = {f"over.{kind}": f"{kind}.{number}" for kind, number in SHARES.values()} | {
    column: f"{kind}.{number}" for column, (kind, number) in SHARES.items()}  # fmt: skip
SCENE = "scene"


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
    values: dict[str, Values] = field(default_factory=dict)  # by scene, seed and view, where there are any, by column

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
    enhancements: Mapping[int, str] | None = None, scores: Mapping[int, Mapping[str, Any]] | None = None,
) -> list[Line]:  # fmt: skip
    """One line for each combination of all axes but the seed of a study's table, best first at each place.

    `competes`: whether a method may be the best, by name; `enhancements`: what the noise-free pictures of each run are
    enhanced by, by number of the row, where known; `scores`: of the runs view by view, likewise.
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
                line.values[column] = _values(line, column, scores or {})
    found = []
    for members in by_place(list(groups.values())).values():
        numbers = [row["run"] for line in members for row in line.runs if "run" in row]
        alike = len({(enhancements or {}).get(number) for number in numbers} - {None}) <= 1
        for line in members:
            line.alike = alike
        for column, _, _, more, digits in columns():
            _made_alike([line.values for line in members], column)
            known = {line.method: line.values[column] for line in members
                     if column in line.values and competes[line.method] and (alike or column not in OWN)
                     and not (is_helped(column) and line.in_linear_light)}  # fmt: skip
            for name, rank in places(known, more, digits).items():
                next(line for line in members if line.method == name).places[column] = rank
        found += _best_first(members)
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
    """How often which method comes first, by the main score and by all others that disagree; over several scenes, by
    how much.
    """
    if (main := main_column(lines)) is None:
        return "No score is known of all runs, so no method comes first."
    if not any(competes[line.method] for line in lines):
        return "Only methods that see truth were run."
    headings = {column: heading for column, heading, *_ in columns()}
    found, of = first_places(lines, main), comparisons(lines, main)
    if not of:
        return f"Nowhere do two methods that see no truth compete by {headings[main]}, so none comes first."
    if not found:
        told = f"No difference is seen: in {_counted(of)} by {headings[main]} no method that sees no truth comes first."
        return told + _overall(lines, main, competes)
    best = next(iter(found))
    others = [f"{name} in {times}" for name, times in found.items() if name != best]
    others += [f"no difference is seen in {of - sum(found.values())}"] if sum(found.values()) < of else []
    rest = f"; {join(others)}" if others else ""
    text = f"{best} comes first in {found[best]} of {_counted(of)} by {headings[main]}{rest}."
    return text + _overall(lines, main, competes) + _dissent(lines, main, best)


def _counted(count: int) -> str:
    return f"{count} comparison{'' if count == 1 else 's'}"


def _overall(lines: Sequence[Line], main: str, competes: Mapping[str, bool]) -> str:
    """Over the scenes of a study: how far the best method is above each other one, where all else is alike."""
    values = over_scenes(lines, main)
    said = []
    for place, methods in values.items():
        known = {name: own for name, own in methods.items() if competes[name]}
        if len({scene for own in known.values() for scene, _, _ in own}) < 2 or len(known) < 2:
            continue
        best, *others = order(known, True)
        apart = {name: found for name in others if (found := difference(known[best], known[name]))}
        if not apart:  # no scene has two of them yet
            continue
        where = max(apart.values(), key=lambda found: found.scenes).where
        listed = [f"{_apart(found)} above {name}{'' if found.where == where else f' ({found.where})'}"
                  for name, found in apart.items()]  # fmt: skip
        said.append(f" Over {where}{f' ({place})' if place else ''}, {best} is {join(listed)}.")
    return "".join(said)


def _apart(found: Estimate) -> str:
    error = "" if found.error is None else f" ± {found.error:.2f}"
    return f"{signed(found.value)}{error}{'' if found.seen else ' (not seen to differ)'}"


def over_scenes(lines: Sequence[Line], column: str) -> dict[str, dict[str, Values]]:
    """The values of a column by method, by all axes but the scene."""
    found: dict[str, dict[str, Values]] = {}
    for line in lines:
        if column in line.values:
            place = spelled({name: value for name, value in line.place.items() if name != SCENE})
            own = found.setdefault(place, {})
            own[line.method] = {**own.get(line.method, {}), **line.values[column]}
    return found


def _dissent(lines: Sequence[Line], main: str, best: str) -> str:
    """By which other scores another method comes first; scores in which the best takes no place say nothing of it."""
    apart: dict[str, list[str]] = {}
    for column, heading, *_ in columns():
        placed = any(column in line.places for line in lines if line.method == best)
        found = first_places(lines, column) if placed and column not in (main, *SILENT) else {}
        winner = next(iter(found), best)
        if winner != best:
            of = comparisons(lines, column)
            said = f"{winner} comes first in {found[winner]} of {of}, {best} in {found.get(best, 0)}"
            apart.setdefault(said, []).append(heading)
    return "".join(f" Not so by {'; '.join(scores)}: there {said}." for said, scores in apart.items())


def comparisons(lines: Sequence[Line], column: str) -> int:
    """At how many places several methods compete by a column."""
    return sum(sum(column in line.places for line in members) > 1 for members in by_place(lines).values())


def first_places(lines: Sequence[Line], column: str) -> dict[str, int]:
    """How often each method alone comes first by a column, most often first; places with one rival do not count."""
    found: dict[str, int] = {}
    for members in by_place(lines).values():
        placed = [line for line in members if column in line.places]
        leaders = [line.method for line in placed if line.places[column] == 1]
        if len(placed) > 1 and len(leaders) == 1:
            found[leaders[0]] = found.get(leaders[0], 0) + 1
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _values(line: Line, column: str, scores: Mapping[int, Mapping[str, Any]]) -> Values:
    """The values of a line by scene, seed and view; of runs of which only the mean is known, that."""
    source = DERIVED.get(column, column)
    kind, _, number = source.partition(".")
    found: dict[tuple[str, str, str], float] = {}
    for row in line.runs:
        if (mean := _value(row, source)) is None:
            continue
        scene, seed = str(line.place.get(SCENE, "")), str(row.get(SEED, ""))
        views = values_of(scores.get(int(row.get("run", 0)), {}), kind, number, scene, seed) if number else {}
        alike = isclose(fmean(views.values()), mean, rel_tol=1e-6) if views else False
        found |= views if alike else {(scene, seed, ""): mean}  # the run may have been scored again since
    return found


def _value(row: Row, column: str) -> float | None:
    value = measured(row.get(column)) if row["state"] == "done" else None
    return None if value is None else value * SCALES.get(column, 1.0)


def _made_alike(several: Sequence[dict[str, Values]], column: str) -> None:
    """Replace views by the mean of their run, if any run has a mean alone: views and means cannot be paired."""
    own = [values for values in several if column in values]
    if any(not view for values in own for _, _, view in values[column]):
        for values in own:
            runs = dict[tuple[str, str], list[float]]()
            for (scene, seed, _), value in values[column].items():
                runs.setdefault((scene, seed), []).append(value)
            values[column] = {(*run, ""): fmean(found) for run, found in runs.items()}


def _best_first(members: Sequence[Line]) -> list[Line]:
    """The lines of one place by the score that decides; those without it last."""
    main = MAIN if members[0].alike else MAIN[::-1]  # all lines of a place agree
    column = next((each for each in main if any(each in line.values for line in members)), "")
    names = order({line.method: line.values[column] for line in members if column in line.values}, True)
    return sorted(members, key=lambda line: names.index(line.method) if line.method in names else len(names))
