"""The table of entries that every page of a site shows a part of."""

from collections.abc import Mapping, Sequence

from markupsafe import Markup

from novags.testbed.metrics.differences import estimate
from novags.testbed.report.blocks.scores import PLUS_MINUS, SHOWN, placed
from novags.testbed.report.grid import main_column, shown_columns
from novags.testbed.report.parts import Column, Table, TableCell, TableRow, num, text
from novags.testbed.report.rows import Row
from novags.testbed.report.words import named, number
from novags.testbed.site.entries import Entry

SAID = ("Light", "Camera")  # said once below the table where every row says the same; others are on the page then
LINK = Markup('<a href="{}">{}</a>')


def entries_table(
    name: str, label: str, entries: Sequence[Entry], looks: Mapping[str, Row], links: Mapping[str, Mapping[str, str]],
    up: str,
) -> Table:  # fmt: skip
    """Entries in rows: what they are, their place among the methods they are compared with, and their scores.

    Args:
        name: Of the table, for scripts.
        label: For readers who do not see it.
        entries: In the order of the rows.
        looks: How methods appear.
        links: The pages of "Method", "Scene" and "Study", by their names, relative to the site.
        up: From the page to the site: "" or "../".
    """
    columns, facts = shown_columns([entry.line for entry in entries]), [_facts(entry) for entry in entries]
    kept = [kind for kind in facts[0] if kind in SAID or len({own[kind] for own in facts}) > 1] if facts else []
    varied = [kind for kind in kept if len({own[kind] for own in facts}) > 1]
    heads = [Column("Place", kind="num")]
    heads += [Column(kind, attributes={"data-filter": ""} if kind in varied else {}) for kind in kept]
    heads += [Column(heading, unit, "num", more) for _, heading, unit, more, _ in columns]
    rows = []
    for entry, own in zip(entries, facts, strict=True):
        line, look = entry.line, looks[entry.method]
        near = [other.line for other in entry.study.entries if other.line.where == line.where]
        main = main_column([other.line for other in entry.study.entries]) or ""
        first = line.places.get(main)
        place = placed(first, [other.places.get(main) for other in near], look.competes)
        cells = [TableCell(place, Markup(' class="num" data-value="{}"').format("" if first is None else first))]
        for kind in kept:
            said = named(look) if kind == "Method" else own[kind]
            cells.append(text(LINK.format(up + links[kind][own[kind]], said) if kind in links else said))
        for column, _, _, _, digits in columns:
            if column not in line.spread:
                cells.append(num(None, ""))
                continue
            value, rank, known = line.spread[column][0], line.places.get(column), estimate(line.values[column])
            said = SHOWN[column](value) if column in SHOWN else number(value, digits)
            if known is not None and known.error is not None and column not in SHOWN:
                said = PLUS_MINUS.format(said, number(known.error, digits))
            best = rank == 1 and any(other.places.get(column, 1) > 1 for other in near)
            cells.append(num(value, said, rank=rank, best=best))
        rows.append(TableRow(cells, {"data-of": f"{entry.study.name}: {line.where}"}))
    return Table(name, label, heads, rows, "scores searched short")


def _facts(entry: Entry) -> dict[str, str]:
    """What an entry is, by the heading of the column."""
    return {"Method": entry.method, "Scene": entry.scene, "Light": entry.light, "Camera": entry.camera,
            "Else": entry.rest, "Study": entry.study.name}  # fmt: skip
