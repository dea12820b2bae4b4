"""Scores: of one place against every truth and view by view, of many in one table with places at each."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from markupsafe import Markup

from novags.testbed.report.grid import SCALES, Line, main_column, shown_columns
from novags.testbed.report.material import Material
from novags.testbed.report.parts import Cell, Column, Page, Table, TableRow, num
from novags.testbed.report.place import MAIN, Place
from novags.testbed.report.tables import COLUMNS, GEOMETRY, NOISE, Columns, digits, per_view, score_table
from novags.testbed.report.verdict import geometry_table, noise_table, placed_in
from novags.testbed.report.words import named, number, share, signed
from novags.testbed.stages.scoring import bounds_of
from novags.testbed.study.light import METHOD
from novags.testbed.study.results import CSV
from sensor_model.files.door import resolved

LPIPS = "lit.lpips"
SHOWN = {"recovered": share, "recovered_lit": share, "over.enhanced": signed, "over.lit": signed}  # else by digits
SPREAD = {"mean": "Mean", "sd": "Standard deviation", "worst": "Worst view", "best": "Best view"}
RANK = Column("#", kind="rank", attributes={"title": "Place by the column that the table is sorted by"})
RANK_THERE = Column("#", kind="rank", attributes={"title": "Place among the methods of the same combination, by the "
                                                           "column that the table is sorted by"})  # fmt: skip
GridColumns = Sequence[tuple[str, str, str, bool, int]]


def scores(material: Material, page: Page) -> dict[str, Any]:
    """The tables of one place, or the one of many."""
    return _of_many(material, page) if material.one is None else _of_one(material, material.one, page)


def _of_one(material: Material, place: Place, page: Page) -> dict[str, Any]:
    metrics, competes = place.metrics, {name: row.competes for name, row in place.rows.items()}
    commands = {made.name: material.commands[number] for number, made in material.made.items()}
    recovered = {"enhanced": metrics["recovered"], "lit": metrics.get("recovered_lit", {})}
    views = {kind: per_view(metrics, kind) for kind in COLUMNS}
    tables = {}
    for kind, columns in COLUMNS.items():
        over, base = place.deltas(kind) if kind in MAIN else ({}, "")
        more = [(Column(f"Over {base}", "dB", "num"), over, signed)] if over else []
        more += [(Column("Recovered", kind="num"), recovered[kind], share)] if recovered.get(kind) else []
        found = score_table(metrics, kind, competes, placed_in(place, kind))
        tables[kind] = ranked_table(f"scores-{kind}", f"Scores against {kind}", columns, found, place, commands, more)
    surfaces = ranked_table(
        "geometry", "Scores against the true surfaces", GEOMETRY, geometry_table(place), place, commands
    )
    noise = ranked_table("noise", "Scores against the known noise", NOISE, noise_table(place), place, commands)
    looks = {name: {"key": row.key, "competes": row.competes} for name, row in place.rows.items()}
    page.data.update(views=views, looks=looks)
    ends = [_ends(place, end) for end in ("floor", "ceiling")] if any(recovered.values()) else []
    return {
        "many": False, "tables": tables, "one_reference": place.one_reference, "geometry": surfaces, "noise": noise,
        "views": {kind: (found, _views(kind, found, place)) for kind, found in views.items() if found},
        "ends": ends if all(ends) else [], "in_linear_light": list(place.exposures),
        "imported": place.capture.imported is not None, "kind": place.lit.views.kind,
        "unscored": [metrics["unavailable"][kind] for kind in COLUMNS if kind in metrics["unavailable"]],
        "methods": [(named(row), row.title) for row in place.rows.values()],
    }  # fmt: skip


def ranked_table(
    name: str, label: str, columns: Columns, rows: Sequence[Mapping[str, Any]], place: Place,
    commands: Mapping[str, str | None], more: Sequence[tuple[Column, Mapping[str, float], Callable[[Any], str]]] = (),
) -> Table | None:  # fmt: skip
    """A table of runs, best first, of rows as of `ranked`; `more`: columns behind, their values, how they are shown."""
    first = {"data-sorted": "descending" if columns[0][3] else "ascending"}
    shown = [
        Column(heading, unit, "num", better, {} if k else first) for k, (_, heading, unit, better) in enumerate(columns)
    ]
    found = []
    for row in rows:
        cells = [num(c["value"], digits(c["key"]), rank=c["rank"], best=c["best"]) for c in row["cells"]]
        rank = Cell(row["cells"][0]["rank"] or ("" if row["competes"] else "†"), {"class": "rank"})
        for _, values, said in more:
            value = values.get(row["method"])
            cells.append(num(value, "" if value is None else said(value)))
        found.append(TableRow([rank, Cell(named(place.rows[row["method"]])), *cells],
                              {"data-command": commands.get(row["method"])}))  # fmt: skip
    shown = [RANK, Column("Method"), *shown, *(column for column, *_ in more)]
    return Table(name, label, shown, found, "scores") if found else None


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
    """One end of the scale of what is recovered, in words; "" where it has no run."""
    names = bounds_of({name: run.method for name, run in place.runs.items()}).get(end, [])
    return "".join(names) if len(names) < 2 else f"the mean of {len(names)} runs of {place.runs[names[0]].method}"


def _of_many(material: Material, page: Page) -> dict[str, Any]:
    lines, columns = material.lines, shown_columns(material.lines)
    axes = [name for name in material.varied if name in lines[0].place]
    heads = [RANK_THERE, *_filters("Method", *axes), Column("Runs", kind="num"), *_columns(columns, arrows=True)]
    rows = (_line(line, material, page, axes, columns) for line in lines)
    return {
        "many": True, "table": Table("combinations", "Scores of every combination", heads, rows, "scores"),
        "runs": _runs(material, columns) if material.study else None, "lost": material.lost,
        "in_linear_light": list(dict.fromkeys(line.method for line in lines if line.in_linear_light)),
        "alike": all(line.alike for line in lines), "no_lpips": not any(LPIPS in line.spread for line in lines),
        "pictures": bool(page.views), "floors": not material.study, "seeds": any(len(line.runs) > 1 for line in lines),
        "csv": CSV if material.study and resolved(material.path.parent) == resolved(material.study[0]) else None,
    }  # fmt: skip


def _filters(*names: str) -> list[Column]:
    return [Column(name, attributes={"data-filter": ""}) for name in names]


def _columns(columns: GridColumns, *, arrows: bool) -> list[Column]:
    return [Column(heading, unit, "num", more, arrow=arrows) for _, heading, unit, more, _ in columns]


def _line(line: Line, material: Material, page: Page, axes: Sequence[str], columns: GridColumns) -> TableRow:
    """The runs that differ in their seed alone."""
    main, look = (
        main_column(material.lines) or next((column for column, *_ in columns), ""),
        material.looks[line.method],
    )
    view, done = page.views.get((line.where, line.method)), sum(row["state"] == "done" for row in line.runs)
    commands = [found for each in line.runs if (found := material.commands.get(int(each["run"])))]
    cells = [Cell(line.places.get(main) or ("" if look.competes else "†"), {"class": "rank"}), Cell(named(look))]
    for value in (line.place[axis] for axis in axes):
        cells.append(Cell(value, {"class": "axis"} if isinstance(value, int | float) else {}))
    cells.append(num(done, f"{done} of {len(line.runs)}" if done < len(line.runs) else str(done)))
    for column, _, _, _, places in columns:
        mean, sd = line.spread.get(column, (None, None))
        text, rank = "" if mean is None else _text(column, mean, places), line.places.get(column)
        text = text if sd is None else Markup("{} <small>± {}</small>").format(text, _text(column, sd, places))
        cells.append(num(mean, text, rank=rank, sd=sd, best=rank == 1))
    return TableRow(cells, {"data-of": line.where, "data-command": "\n".join(commands) or None, "data-view": view,
                            "data-picture": view and f"render-{line.method}"})  # fmt: skip


def _text(column: str, value: float, places: int) -> str:
    return SHOWN[column](value) if column in SHOWN else number(value, places)


def _runs(material: Material, columns: GridColumns) -> Table:
    """Every run of a study by itself."""
    axes, rows = material.varied, list[TableRow]()
    for row in material.rows:
        told = [Cell(row[name], {}) for name in ("run", *axes, "state")]
        cells = [told[0], Cell(named(material.looks[row[METHOD]])), *told[1:]]
        for column, _, _, _, places in columns:
            value = row.get(column) if row["state"] == "done" else None
            value = value * SCALES.get(column, 1) if isinstance(value, int | float) else value
            shown = "" if value is None else value if isinstance(value, str) else _text(column, value, places)
            cells.append(num(value, shown))
        command = material.commands.get(int(row["run"]))
        rows.append(TableRow(cells, {"data-of": f"run {row['run']}", "data-command": command}))
    heads = [Column("Run", kind="num"), *_filters("Method", *axes, "State"), *_columns(columns, arrows=False)]
    return Table("runs", "Scores of every run", heads, rows, "scores", whole=True)
