"""Parts of blocks: a page in the making, and tables, all in one form."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from markupsafe import Markup, escape

from novags.testbed.console.terminal import Update
from novags.testbed.report.look.album import Album
from novags.testbed.report.look.pictures import Tile, ViewTiles
from novags.testbed.report.material import Material
from novags.testbed.report.words import number

Attributes = Mapping[str, Any]  # of an element; attributes that are None are left out


@dataclass(frozen=True)
class Strip:
    """The pictures that a page begins with: one view dark, as the floor and the best method show it, and its truth."""

    view: ViewTiles
    tiles: Sequence[Tile]

    @property
    def keys(self) -> set[str]:
        """What the grid of that view takes from here, so that no picture is twice in the page."""
        return {tile.key for tile in self.tiles}


@dataclass
class Page:
    """A page in the making."""

    path: Path
    album: Album
    progress: Update
    views: dict[tuple[str, str], str] = field(default_factory=dict)  # that show a run, by its place and its name
    data: dict[str, Any] = field(default_factory=dict)  # what the scripts need
    strip: Strip | None = None


Shown = Mapping[str, Any] | None


@dataclass(frozen=True)
class Block:
    """A part of a page, for one place or many; `BLOCKS` says which there are."""

    name: str  # of its template
    read: Callable[[Material, Page], Shown]  # what the template shows; None where there is nothing
    files: Callable[[Material], Iterable[Path]] = lambda material: ()  # beside the page, that it writes


class Column(NamedTuple):
    """A column of a table; `more`: whether more is better, which an arrow says."""

    heading: Any
    unit: str = ""
    kind: str | None = None  # its class: "num", "rank", "wide"; None of text
    more: bool | None = None
    attributes: Attributes = {}  # of its heading


class TableCell(NamedTuple):
    """A cell; without attributes it is the heading of its row."""

    text: Any
    attributes: Markup | None = None  # as they stand in the page, since there are tens of thousands of cells


class TableRow(NamedTuple):
    """A row of a table; a text in front is its heading."""

    cells: Sequence[Any]
    attributes: Attributes = {}


@dataclass(frozen=True)
class Table:
    """A table that can be sorted and saved."""

    name: str  # by which scripts and links know it
    label: str  # for readers who do not see it
    columns: Sequence[Column]
    rows: Sequence[TableRow]
    style: str = ""  # its class
    foot: Sequence[TableRow] = ()
    whole: bool = False  # whether all rows are laid out at once; otherwise only the first hundred are

    @cached_property
    def same(self) -> dict[int, Markup]:
        """The columns that say the same in every row, and what: they are folded away, and said once below.

        Not of tables with a foot, whose numbers change with a choice of the reader, nor the one that all is sorted by.
        """
        if len(self.rows) < 2 or self.foot:
            return {}
        found = {}
        for k, column in enumerate(self.columns):
            cells = [row.cells[k] for row in self.rows]
            heading = isinstance(cells[0], TableCell) and cells[0].attributes is None
            if k == 0 or heading or "data-sorted" in column.attributes or "data-filter" in column.attributes:
                continue
            texts = {escape(cell.text if isinstance(cell, TableCell) else cell) for cell in cells}
            if len(texts) == 1:
                found[k] = texts.pop()
        return found


def plain(table: Table) -> list[str]:
    """A table as lines of text, in columns; those that say the same in every row are left out."""
    shown = [k for k in range(len(table.columns)) if k not in table.same]
    lines = [[f"{table.columns[k].heading} {table.columns[k].unit}".strip() for k in shown]]
    for row in table.rows:
        cells = (cell.text if isinstance(cell := row.cells[k], TableCell) else cell for k in shown)
        lines.append([Markup(escape(cell)).striptags() for cell in cells])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    right = [table.columns[k].kind == "num" for k in shown]
    sides = [str.rjust if each else str.ljust for each in right]
    return [
        "  ".join(side(text, width) for side, text, width in zip(sides, line, widths, strict=True)).rstrip()
        for line in lines
    ]


def heads(said: str) -> list[Column]:
    """Columns from their headings, as in "Stage | #Time [s]": numbers have a #."""
    found = []
    for head in said.split(" | "):
        heading, _, unit = head.rstrip("]").partition(" [")
        found.append(Column(heading.removeprefix("#"), unit, "num" if heading.startswith("#") else None))
    return found


def text(value: Any, kind: str = "") -> TableCell:
    """A cell of a class."""
    return TableCell(value, Markup(' class="{}"').format(kind) if kind else Markup())


def num(
    value: Any, shown: str | int = 2, *, rank: int | None = None, best: bool = False,
    beside: Mapping[str, Any] = MappingProxyType({}),
) -> TableCell:  # fmt: skip
    """A number, with the text that shows it or with so many digits; `beside`: further columns of the CSV, `sd`, `error`
    and `scenes` (tables.js); None leaves one out.
    """
    said = shown if isinstance(shown, str) else number(value, shown)
    kind = " best" if best else " muted" if value is None and said else ""
    told = f' class="num{kind}" data-value="{"" if value is None else escape(value)}"'
    told += "" if rank is None else f' data-rank="{rank}"'
    told += "".join(f' data-{name}="{escape(known)}"' for name, known in beside.items() if known is not None)
    return TableCell(said, Markup(told))
