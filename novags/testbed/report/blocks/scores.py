"""Scores: of one place against every truth and view by view, of many in one table with places at each."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Any

from markupsafe import Markup

from novags.testbed.metrics.differences import Estimate
from novags.testbed.metrics.truth import WITHIN
from novags.testbed.report.grid import SCALES, Line, main_column, shown_columns
from novags.testbed.report.material import Material
from novags.testbed.report.parts import Column, Page, Table, TableCell, TableRow, num, text
from novags.testbed.report.place import MAIN, Place
from novags.testbed.report.tables import KINDS, columns, digits, per_view
from novags.testbed.report.verdict import AGAINST, table_of
from novags.testbed.report.words import named, number, share, signed
from novags.testbed.stages.scores.comparing import bounds_of
from novags.testbed.study.differences import DIFFERENCES
from novags.testbed.study.light import METHOD
from novags.testbed.study.results import CSV
from sensor_model.files.door import resolved

LPIPS = "lit.lpips"
LONG = 20  # letters of a place that need room
LABELS = {"geometry": ("geometry", "the true surfaces"), "noise": ("noise", "the known noise")}
SHOWN = {"recovered": share, "recovered_lit": share, "over.enhanced": signed, "over.lit": signed}  # else by digits
PLUS_MINUS = Markup("{} <small>± {}</small>")
SPREAD = {"mean": "Mean", "sd": "Standard deviation", "worst": "Worst view", "best": "Best view"}
THERE = "Place among the methods that are compared with each other, by the column that the table is sorted by"
RANK = Column("#", kind="rank", attributes={"title": THERE})
More = tuple[Column, Mapping[str, Estimate], Callable[[float], str]]  # values by run, and how they are shown
Grid = Sequence[tuple[str, str, str, bool, int]]  # as `columns` of `grid`


def scores(material: Material, page: Page) -> dict[str, Any]:
    """The tables of one place, or the table of many."""
    return _of_many(material, page) if material.one is None else _of_one(material, material.one, page)


def _of_one(material: Material, place: Place, page: Page) -> dict[str, Any]:
    metrics = place.metrics
    commands = {made.name: material.commands[number] for number, made in material.made.items()}
    recovered = {"enhanced": metrics["recovered"], "lit": metrics["recovered_lit"]}
    views = {kind: per_view(metrics, kind) for kind in KINDS if kind not in LABELS}
    tables = {}
    for kind in KINDS:
        over, base = place.deltas(kind) if kind in MAIN else ({}, "")
        more = [(Column(f"Over {base}", "dB", "num"), over, signed)] if over else []
        more += [(Column("Recovered", kind="num"), recovered[kind], share)] if recovered.get(kind) else []
        tables[kind] = ranked_table(kind, place, commands, more)
    alone = [said for kind in tables if (said := _alone(kind, tables[kind]))]
    looks = {name: {"key": row.key, "competes": row.competes} for name, row in place.rows.items()}
    page.data.update(views=views, looks=looks)
    ends = [_ends(place, end) for end in ("floor", "ceiling")] if any(recovered.values()) else []
    return {
        "many": False, "tables": {kind: None if _alone(kind, table) else table for kind, table in tables.items()},
        "alone": alone, "one_reference": place.one_reference,
        "views": {kind: (found, _views(kind, found, place)) for kind, found in views.items() if found},
        "ends": ends if all(ends) else [], "in_linear_light": list(place.exposures),
        "imported": place.capture.imported is not None, "kind": place.lit.views.kind,
        "unscored": [metrics["unavailable"][kind] for kind in views if kind in metrics["unavailable"]],
        "methods": [(named(row), row.title) for row in place.rows.values()],
    }  # fmt: skip


def _alone(kind: str, table: Table | None) -> Any:
    """What a table of a single number would say, in words that take no screen; "" of any other."""
    if table is None or len(table.rows) > 1 or len(columns(kind)) > 1:
        return ""
    _, name, cell, *_ = table.rows[0].cells
    (_, heading, unit, _), against = columns(kind)[0], AGAINST.get(kind, kind)
    return Markup("{}: {} {} {} against {}").format(name.text, heading, cell.text, unit, against)


def ranked_table(
    kind: str, place: Place, commands: Mapping[str, str | None], more: Sequence[More] = (), *, count: int | None = None,
    name: str | None = None,
) -> Table | None:  # fmt: skip
    """The runs of a place, best first, with the first `count` scores and what stands behind them; None of no scores."""
    rows, shown = list[TableRow](), [RANK, Column("Method")]
    for key, heading, unit, better in columns(kind)[:count]:
        first = {"data-sorted": "descending" if better else "ascending"} if key == columns(kind)[0][0] else {}
        shown.append(Column(heading, unit, "num", better, first))
    found = table_of(place, kind)
    ranks = [row["cells"][0]["rank"] for row in found]
    for row in found:
        run, rank = row["method"], placed(row["cells"][0]["rank"], ranks, row["competes"])
        cells = [num(c["value"], _score(c), rank=c["rank"], best=c["best"]) for c in row["cells"][:count]]
        cells += [_estimated(values.get(run), said) for _, values, said in more]
        cells = [text(rank, "rank"), TableCell(named(place.rows[run])), *cells]
        rows.append(TableRow(cells, {"data-command": commands.get(run)}))
    own, against = LABELS.get(kind, (f"scores-{kind}", kind))
    shown += [column for column, *_ in more]
    label = f"Scores against {against}" if name is None else "The ranking"
    return Table(name or own, label, shown, rows, "scores") if rows else None


def placed(rank: int | None, ranks: Sequence[int | None], competes: bool) -> str:
    """A place as it is written: with "=" where it is shared; a dagger for a bound."""
    if rank is None:
        return "" if competes else "†"
    return f"{rank}{'=' * (ranks.count(rank) > 1)}"


def _score(cell: Mapping[str, Any]) -> str | int:
    """A score as it is printed; where the noise of the truth leaves nothing of it, that."""
    return WITHIN if cell["value"] is None and cell["error"] == inf else digits(cell["key"])


def _estimated(found: Estimate | None, said: Callable[[float], str]) -> TableCell:
    if found is None:
        return num(None, "")
    error = "" if found.error is None else said(found.error).lstrip("+")
    return num(found.value, PLUS_MINUS.format(said(found.value), error) if error else said(found.value))


def _views(kind: str, found: Mapping[str, Any], place: Place) -> Table:
    score = next(iter(found["scores"].values()))
    rows = [TableRow([view, *(num(value, score["digits"]) for value in values)], {"data-view": view})
            for view, values in zip(found["views"], score["values"], strict=True)]  # fmt: skip
    spread = {what: [num(value, "" if value is None else score["digits"]) for value in score["spread"][what]]
              for what in SPREAD}  # fmt: skip
    foot = [TableRow([label, *spread[what]], {"data-spread": what}) for what, label in SPREAD.items()]
    columns = [Column("View"), *(Column(named(place.rows[name]), kind="num") for name in found["methods"])]
    return Table(f"views-{kind}", "Scores of every held-out view", columns, rows, foot=foot)


def _ends(place: Place, end: str) -> str:
    """One end of the scale of recovered shares, in words; "" where it has no run."""
    names = bounds_of({name: run.method for name, run in place.runs.items()}).get(end, [])
    return "".join(names) if len(names) < 2 else f"the mean of {len(names)} runs of {place.runs[names[0]].method}"


def _of_many(material: Material, page: Page) -> dict[str, Any]:
    lines, columns = material.lines, shown_columns(material.lines)
    axes = [name for name in material.varied if name in lines[0].place]
    main = main_column(lines) or next((column for column, *_ in columns), "")
    heads = [RANK, *_filters("Method", *axes), Column("Runs", kind="num"), *_columns(columns)]
    ranks = {where: [line.places for line in lines if line.where == where] for where in {line.where for line in lines}}
    rows = [_line(line, material, page, axes, columns, main, ranks[line.where]) for line in lines]
    return {
        "many": True, "table": Table("combinations", "Scores of every combination", heads, rows, "scores"),
        "methods": _methods(material),
        "runs": _runs(material, columns) if material.study else None, "lost": material.lost,
        "in_linear_light": list(dict.fromkeys(line.method for line in lines if line.in_linear_light)),
        "alike": all(line.alike for line in lines), "no_lpips": not any(LPIPS in line.spread for line in lines),
        "pictures": bool(page.views), "floors": not material.study, "seeds": any(len(line.runs) > 1 for line in lines),
        "csv": CSV if material.study and resolved(material.path.parent) == resolved(material.study[0]) else None,
        "differences": _differences(material),
    }  # fmt: skip


def _differences(material: Material) -> str | None:
    return DIFFERENCES if material.study and (material.study[0] / DIFFERENCES).is_file() else None


def _methods(material: Material) -> list[tuple[Any, str]]:
    """The work of each method, by name; of runs of several captures once for those of one name."""
    found = material.looks
    if not material.study:
        runs = {made.name: made.run.name for made in material.made.values()}
        found = {run: replace(found[name], name=run) for name, run in runs.items()}
    return [(named(look), look.title) for look in found.values() if look.title]


def _filters(*names: str) -> list[Column]:
    return [Column(name, attributes={"data-filter": ""}) for name in names]


def _columns(columns: Grid) -> list[Column]:
    return [Column(heading, unit, "num", more) for _, heading, unit, more, _ in columns]


def _line(
    line: Line, material: Material, page: Page, axes: Sequence[str], columns: Grid, main: str,
    near: Sequence[Mapping[str, int]],
) -> TableRow:  # fmt: skip
    """The runs that differ in their seed alone; `near`: the places of all that are compared with them."""
    look, view = material.looks[line.method], page.views.get((line.where, line.method))
    done, of = sum(row["state"] == "done" for row in line.runs), len(line.runs)
    commands = [found for each in line.runs if (found := material.commands.get(int(each["run"])))]
    first = placed(line.places.get(main), [each.get(main) for each in near], look.competes)
    cells = [text(first, "rank"), TableCell(named(look))]
    for value in (line.place[axis] for axis in axes):
        kind = "axis" if isinstance(value, int | float) else "where" if len(value) > LONG else ""
        cells.append(text(value, kind))
    cells.append(num(done, f"{done} of {of}" if done < of else str(done)))
    for column, _, _, _, places in columns:
        mean, sd = line.spread.get(column, (None, None))
        said, rank = _text(column, mean, places), line.places.get(column)
        said = said if sd is None else PLUS_MINUS.format(said, _text(column, sd, places))
        best = rank == 1 and any(each.get(column, 1) > 1 for each in near)
        cells.append(num(mean, said, rank=rank, beside={"sd": sd}, best=best))
    return TableRow(cells, {"data-of": line.where, "data-command": "\n".join(commands) or None, "data-view": view,
                            "data-picture": view and f"render-{line.method}"})  # fmt: skip


def _text(column: str, value: Any, places: int) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    return SHOWN[column](value) if column in SHOWN else number(value, places)


def _runs(material: Material, columns: Grid) -> Table:
    """Every run of a study by itself."""
    axes, rows = material.varied, list[TableRow]()
    for row in material.rows:
        cells = [text(row["run"]), TableCell(named(material.looks[row[METHOD]]))]
        cells += [text(row[name]) for name in (*axes, "state")]
        for column, _, _, _, places in columns:
            value = row.get(column) if row["state"] == "done" else None
            value = value * SCALES.get(column, 1) if isinstance(value, int | float) else value
            cells.append(num(value, _text(column, value, places)))
        told = {"data-of": f"run {row['run']}", "data-command": material.commands.get(int(row["run"]))}
        rows.append(TableRow(cells, told))
    heads = [Column("Run", kind="num"), *_filters("Method", *axes, "State"), *_columns(columns)]
    return Table("runs", "Scores of every run", heads, rows, "scores", whole=True)
