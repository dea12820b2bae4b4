"""The ranking that a page begins with: methods by the score that decides, with errors and ties, and one chart of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from markupsafe import Markup

from novags.testbed.metrics.differences import Estimate, Values, estimate, order, places
from novags.testbed.report.blocks.scores import PLUS_MINUS, placed, ranked_table
from novags.testbed.report.charts import MARKS, Axis, Chart, Point, Series, few
from novags.testbed.report.grid import CAPTURE, SCENE, Line, columns, main_column
from novags.testbed.report.material import Material
from novags.testbed.report.parts import Column, Page, Table, TableCell, TableRow, num, text
from novags.testbed.report.place import Place
from novags.testbed.report.rows import Row
from novags.testbed.report.verdict import leading
from novags.testbed.report.words import named, number, share, signed
from novags.testbed.stages.scores.comparing import mean_values
from novags.testbed.study.cells.grid import spelled
from novags.testbed.study.light import ELECTRONS, SEED

SECONDS = "seconds.reconstruct"
FEWER = Markup("{} <small>({} scenes)</small>")
BEHIND = "A method stands behind each one that is seen to be better; equal places share a colour."
PANELS = 24  # small charts: of more places nobody compares all
TALL, WIDE = 230, 420  # px of a chart; as wide as a telephone, so that its letters keep their size there


@dataclass(frozen=True)
class Pivot:
    """The values of a column by condition and method: all axes but method, scene and seed make the condition."""

    heading: str
    unit: str
    more: bool
    digits: int
    values: dict[str, dict[str, Values]]  # of competing and other methods, by the condition in words
    ranked: dict[str, dict[str, int]]  # the place of each method that takes one, by condition
    scenes: list[str]  # [] where no axis is the scene

    @property
    def of_scenes(self) -> bool:
        """Whether the scenes are what is told apart: there is one condition alone."""
        return len(self.values) == 1 and len(self.scenes) > 1


def ranking(material: Material) -> dict[str, Any]:
    """The table, the chart, what to know of both, and of the table without colours; {} where nothing is scored."""
    if material.one is not None:
        return _of_one(material, material.one)
    if (found := pivot(material)) is None:
        return {}
    over = f"mean over {len(found.scenes)} scenes" if len(found.scenes) > 1 else "mean over seeds and views"
    legend = f"{found.heading}, {over}; ± is its standard error, of one scene over its seeds and views."
    return {
        "table": pivot_table(found, material),
        "chart": _chart_of_many(found, material),
        "said": f"{legend} {BEHIND}{_bounds(material.looks)}",
        "legend": legend + _bounds(material.looks),
    }


def _of_one(material: Material, place: Place) -> dict[str, Any]:
    if (found := leading(place)) is None:
        return {}
    kind, seconds = found[0], seconds_of(material)
    over, base = place.deltas(kind)
    recovered = place.metrics["recovered" if kind == "enhanced" else "recovered_lit"]
    more = [(Column(f"Over {base}", "dB", "num"), over, signed)] if over else []
    more += [(Column("Recovered", kind="num"), recovered, share)] if recovered else []
    commands = {made.name: material.commands[number] for number, made in material.made.items()}
    table = ranked_table(kind, place, commands, more, count=1, name="ranking")
    known = {base: Estimate(0.0, None, 0.0, "", 1, 1, 1), **over}  # the base is 0 dB from itself
    points = {name: (seconds[name], each) for name, each in known.items() if name in seconds}
    said = "± is the standard error of the difference. Equal places (=): no difference is seen." + _bounds(place.rows)
    chart = over_time([(f"dB over {base}", points)], place.rows)[0] if over else ""
    return {"table": table, "chart": chart, "said": said if over else "", "legend": said if over else ""}


def pivot(material: Material) -> Pivot | None:
    """The score that decides, of many places; None where none is known of all."""
    lines = material.lines
    if (main := main_column(lines)) is None:
        return None
    heading, unit, more, digits = next(each[1:] for each in columns() if each[0] == main)
    values, ranked = dict[str, dict[str, Values]](), dict[str, dict[str, int]]()
    for line in lines:
        if main in line.values:
            own = values.setdefault(_condition(line, material.varied), {})
            name = method_of(line, material)
            own[name] = {**own.get(name, {}), **line.values[main]}
    for condition, own in values.items():
        ranked[condition] = places({name: each for name, each in own.items() if material.looks[name].competes},
                                   more, digits)  # fmt: skip
    scenes = list(dict.fromkeys(str(line.place[SCENE]) for line in lines if SCENE in line.place))
    return Pivot(heading, unit, more, digits, values, ranked, scenes) if values else None


def method_of(line: Line, material: Material) -> str:
    """The name of a row: the method, or of runs without a study their name, which several captures may share.

    Where a capture has two runs of a name, the names that tell them apart.
    """
    if material.study or material.one:
        return line.method
    here = [material.called(made[0]) for other in material.lines if other.where == line.where
            and (made := material.of(other))]  # fmt: skip
    own = material.called(material.of(line)[0])
    return own if here.count(own) == 1 else line.method


def _condition(line: Line, varied: Sequence[str]) -> str:
    place = {name: value for name, value in line.place.items() if name in varied and name != SCENE}
    return str(place[CAPTURE]) if [*place] == [CAPTURE] else spelled(place)


def pivot_table(found: Pivot, material: Material) -> Table:
    """A row for each method, best first, and a column for each condition: the mean over its scenes with its error."""
    (first, *_), single = found.values, len(found.values) == 1
    every: dict[str, dict[tuple[str, str, str], float]] = {}
    for condition, own in found.values.items():
        for name, each in own.items():
            mine = every.setdefault(name, {})
            mine |= {(condition + scene, seed, view): value for (scene, seed, view), value in each.items()}
    shown = [Column("#", kind="rank")] if single else []
    shown += [Column("Method")]
    if single:
        mean = f"Mean of {len(found.scenes)} scenes" if found.of_scenes else found.heading
        shown.append(Column(mean, found.unit, "num", found.more))
    else:
        shown += [Column(condition, found.unit, "num", found.more) for condition in found.values]
    by_scene = [_of_scene(found, material, scene) for scene in found.scenes] if found.of_scenes else []
    shown += [Column(scene, found.unit, "num", found.more) for scene in found.scenes] if found.of_scenes else []
    rows = []
    for name in order(every, found.more):
        look = material.looks[name]
        cells: list[Any] = [TableCell(named(look))]
        cells += [_cell(own.get(name), found.ranked[condition], name, found.digits, len(found.scenes))
                  for condition, own in found.values.items()]  # fmt: skip
        cells += [_cell(own.get(name), ranks, name, found.digits) for own, ranks in by_scene]
        if single:
            ranks = found.ranked[first]
            cells.insert(0, text(placed(ranks.get(name), [*ranks.values()], look.competes), "rank"))
        rows.append(TableRow(cells))
    return Table("ranking", "The ranking", shown, rows, "scores")


def _of_scene(found: Pivot, material: Material, scene: str) -> tuple[dict[str, Values], dict[str, int]]:
    (own,) = found.values.values()
    here = {name: {key: value for key, value in each.items() if key[0] == scene} for name, each in own.items()}
    values: dict[str, Values] = {name: mine for name, mine in here.items() if mine}
    competing = {name: each for name, each in values.items() if material.looks[name].competes}
    return values, places(competing, found.more, found.digits)


def _cell(values: Values | None, ranks: Mapping[str, int], name: str, digits: int, scenes: int = 1) -> TableCell:
    """A mean with its error; where runs of some of so many scenes are missing, it says so."""
    known = estimate(values) if values else None
    if known is None:
        return num(None, "")
    said, rank = number(known.value, digits), ranks.get(name)
    said = said if known.error is None else PLUS_MINUS.format(said, number(known.error, digits))
    fewer = "" if known.scenes >= scenes else f"{known.scenes} of {scenes}"
    beside = {"error": known.error, "scenes": fewer or None}
    said = FEWER.format(said, fewer) if fewer else said
    return num(known.value, said, rank=rank, beside=beside, best=rank == 1 and max(ranks.values()) > 1)


def _bounds(rows: Mapping[str, Row]) -> str:
    return "" if all(row.competes for row in rows.values()) else " † sees the truth: a bound and no rival."


def _chart_of_many(found: Pivot, material: Material) -> str:
    """Over the light where that is what the conditions differ in, else over the time that methods take."""
    label, looks = f"{found.heading} [{found.unit}]" if found.unit else found.heading, material.looks
    if [name for name in material.varied if name not in (SCENE, SEED)] == [ELECTRONS]:
        return _over_light(found, label, material)
    seconds = seconds_of(material)
    shared = [name for name in looks if all(name in own for own in found.values.values())]
    whole = {name: mean_values([own[name] for own in found.values.values()]) for name in shared}
    points = {name: (seconds[name], known) for name, own in whole.items()
              if name in seconds and (known := estimate(own)) is not None}  # fmt: skip
    return over_time([(label, points)], looks)[0] if len(points) > 1 else ""


def _over_light(found: Pivot, label: str, material: Material) -> str:
    levels = {_condition(line, material.varied): float(line.place[ELECTRONS]) for line in material.lines}
    drawn = []
    for place, (name, look) in enumerate(material.looks.items()):
        known = {levels[condition]: each for condition, own in found.values.items()
                 if name in own and (each := estimate(own[name])) is not None}  # fmt: skip
        points = [_point(x, known[x]) for x in sorted(known)]
        drawn.append(Series(name, look.key, points, "" if look.competes else "bound", MARKS[place % len(MARKS)]))
    return _chart(label, "electrons per green pixel", [each for each in drawn if each.points], sorted(levels.values()))


def over_time(
    panels: Sequence[tuple[str, Mapping[str, tuple[float, Estimate]]]], looks: Mapping[str, Row]
) -> list[str]:
    """A chart for each panel, all on common axes: the score of each method over the seconds that it took."""
    drawn = [(label, [Series(name, looks[name].key + " off" * (not looks[name].competes), [_point(x, each)], None,
                             MARKS[list(looks).index(name) % len(MARKS)])
                      for name, (x, each) in points.items() if x > 0]) for label, points in panels]  # fmt: skip
    every = [series for _, of in drawn for series in of]
    return [_chart(label, "seconds to reconstruct", of, (), every) for label, of in drawn]


def _point(x: float, known: Estimate) -> Point:
    error = known.error or 0.0
    said = number(known.value) + (f" ± {number(error)}" if error else "")
    return Point(x, known.value, said, known.value - error, known.value + error)


def _chart(
    label: str, over: str, series: Sequence[Series], levels: Sequence[float], every: Sequence[Series] | None = None
) -> str:
    """Series on the axes that `every` one of them needs, names beside them; "" where no score is finite."""
    points = [point for each in every or series for point in each.points]
    if not points:
        return ""
    ends = [end for point in points for end in (point.low, point.high) if end is not None]
    room = [point.x * factor for point in points for factor in (0.8, 1.25)]  # for names
    x = Axis.around(over, room, log=True, ticks=few(levels))
    return Chart(f"{label} over {over}", x, Axis.around(label, ends), series, WIDE, TALL, left=56, named=True).svg()


def seconds_of(material: Material) -> dict[str, float]:
    """The mean time of the reconstruction by each method."""
    found: dict[str, list[float]] = {}
    for line in material.lines:
        if SECONDS in line.spread:
            found.setdefault(method_of(line, material), []).append(line.spread[SECONDS][0])
    return {name: fmean(values) for name, values in found.items()}


def multiples(material: Material, page: Page) -> dict[str, Any] | None:
    """Small charts on common axes, one for each place of a study: how far each method comes in how much time.

    None where the light varies, over which there are charts then.
    """
    if material.study is None or ELECTRONS in material.varied:
        return None
    main, groups = main_column(material.lines), dict[str, dict[str, tuple[float, Estimate]]]()
    for line in material.lines:
        known = estimate(line.values[main]) if main in line.values else None
        if SECONDS in line.spread and known is not None:
            groups.setdefault(line.where, {})[method_of(line, material)] = (line.spread[SECONDS][0], known)
    if not 1 < len(groups) <= PANELS:
        return None
    heading, unit = next(each[1:3] for each in columns() if each[0] == main)
    label = f"{heading} [{unit}]" if unit else heading
    drawn = over_time([(label, each) for each in groups.values()], material.looks)
    return {"panels": list(zip(groups, drawn, strict=True))}
