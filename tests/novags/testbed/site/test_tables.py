"""Claims about the table of entries: the rows, the columns and the places that a reader of the site sees."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from markupsafe import Markup, escape

from novags.testbed.report.parts import Table
from novags.testbed.site.entries import Entry, looks_of_all
from novags.testbed.site.tables import entries_table
from tests.novags.testbed.site.small_studies import FLIP, LIT, PSNR, dusk, night, studies

LINKS = {"Method": {name: f"methods/{name}.html" for name in ("naive", "better", "oracle")},
         "Scene": {name: f"scenes/{name}.html" for name in ("attic", "barn", "cave")},
         "Study": {name: f"studies/{name}/index.html" for name in ("dusk", "night")}}  # fmt: skip


def of(folder: Path, **rows: Any) -> list[Entry]:
    """The entries of some studies."""
    return [entry for study in studies(folder, **rows) for entry in study.entries]


def table_of(entries: Sequence[Entry], up: str = "") -> Table:
    return entries_table("entries", "Every method at every place", entries, looks_of_all(entries), LINKS, up)


def read(table: Table) -> list[dict[str, str]]:
    """The text of each cell of each row, by the heading of its column."""
    heads = [column.heading for column in table.columns]
    texts = [[Markup(escape(cell.text)).striptags() for cell in row.cells] for row in table.rows]
    return [dict(zip(heads, row, strict=True)) for row in texts]


def test_a_row_says_what_an_entry_is_its_place_and_all_its_scores(tmp_path: Path) -> None:
    table = table_of(of(tmp_path, dusk=dusk(), night=night()))
    assert [(column.heading, column.unit, column.kind, column.more) for column in table.columns] == [
        ("Place", "", "num", None),
        *((name, "", None, None) for name in ("Method", "Scene", "Light", "Camera", "Else", "Study")),
        ("PSNR aligned, noise-free", "dB", "num", True), ("FLIP, noise-free", "", "num", False),
    ]  # fmt: skip
    assert [[*row.values()] for row in read(table)] == [
        ["1=", "better", "attic", "5 electrons", "full frame", "", "dusk", "20.30 ± 0.20", ""],
        ["1=", "naive", "attic", "5 electrons", "full frame", "", "dusk", "20.20 ± 0.20", ""],
        ["1", "naive", "attic", "50 electrons", "full frame", "", "dusk", "26.50 ± 0.50", ""],
        ["2", "better", "attic", "50 electrons", "full frame", "", "dusk", "23.50 ± 0.50", ""],
        ["1", "better", "barn", "5 electrons", "full frame", "", "dusk", "22.50 ± 0.50", ""],
        ["2", "naive", "barn", "5 electrons", "full frame", "", "dusk", "18.50 ± 0.50", ""],
        ["1=", "naive", "barn", "50 electrons", "full frame", "", "dusk", "31.40 ± 0.40", ""],
        ["1=", "better", "barn", "50 electrons", "full frame", "", "dusk", "31.30 ± 0.20", ""],
        ["†", "oracle†", "barn", "2.5 electrons", "telephone", "width 64", "night", "33.00", "0.330"],
        ["1", "better", "barn", "2.5 electrons", "telephone", "width 64", "night", "15.00", "0.150"],
        ["2", "naive", "barn", "2.5 electrons", "telephone", "width 64", "night", "14.00", "0.140"],
        ["†", "oracle†", "cave", "2.5 electrons", "telephone", "width 64", "night", "34.00", "0.340"],
        ["1", "naive", "cave", "2.5 electrons", "telephone", "width 64", "night", "17.00", "0.170"],
        ["2", "better", "cave", "2.5 electrons", "telephone", "width 64", "night", "16.00", "0.160"],
    ]  # fmt: skip
    ranks = [str(row.cells[0].attributes).removeprefix(' class="num" data-value=') for row in table.rows]
    assert ranks == [f'"{rank}"' for rank in (1, 1, 1, 2, 1, 2, 1, 1, "", 1, 2, "", 1, 2)]
    assert [row.attributes["data-of"] for row in table.rows[6:9]] == [
        *["dusk: scene barn, electrons 50, sensor full frame"] * 2,
        "night: scene barn, electrons 2.5, sensor telephone, width 64",
    ]


def test_the_best_score_of_a_place_stands_out_where_another_method_is_seen_to_be_worse(tmp_path: Path) -> None:
    alone = [{**row, "scene": "attic"} for row in night()[:2]]  # beside a method that sees truth
    table = table_of(of(tmp_path, dusk=dusk(), night=[*night(), *alone]))
    best = [[' class="num best"' in str(cell.attributes) for cell in row.cells[-2:]] for row in table.rows]
    none, psnr, flip = [False, False], [True, False], [False, True]
    assert best == [none, none, psnr, none, psnr, none, none, none, none, psnr, flip, none, psnr, flip, none, none]


@pytest.mark.parametrize("which", range(3))
def test_a_score_that_a_single_entry_has_is_a_column(which: int, tmp_path: Path) -> None:
    rows = [{"scene": "attic", "electrons": electrons, "method": "naive", PSNR: 20.0} for electrons in (5, 20, 50)]
    rows[which] |= {FLIP: 0.125, "recovered": 0.25, "over.enhanced": -1.5}
    rows = [row | {"seed": seed} for row in rows for seed in (0, 1)]
    found = read(table_of(of(tmp_path, dusk=rows)))
    said = [[row[name] for name in ("FLIP, noise-free", "Recovered", "Over the floor")] for row in found]
    assert said == [["0.125 ± 0.000", "25 %", "−1.50"] if k == which else [""] * 3 for k in range(3)]


@pytest.mark.parametrize("which", range(3))
def test_what_a_single_entry_has_of_its_own_is_a_column_to_choose_rows_by(which: int, tmp_path: Path) -> None:
    better, naive, _, _, barn, *_ = of(tmp_path, dusk=dusk())
    entries = [better, naive]
    entries.insert(which, barn)
    table = table_of(entries)
    assert {column.heading: "data-filter" in column.attributes for column in table.columns[:-1]} == {
        "Place": False, "Method": True, "Scene": True, "Light": False, "Camera": False
    }  # fmt: skip
    assert [row["Scene"] for row in read(table)] == ["barn" if k == which else "attic" for k in range(3)]


@pytest.mark.parametrize("bare", ["first", "last"])
def test_places_are_by_a_score_that_every_line_of_the_study_has(bare: str, tmp_path: Path) -> None:
    """Of one scene there are no noise-free pictures; by the other score the other method comes first."""
    rows: list[Any] = [{"scene": scene, "method": method, PSNR: psnr, LIT: lit} for scene in ("attic", "barn")
                       for method, psnr, lit in (("better", 25.0, 11.0), ("naive", 24.0, 12.0))]  # fmt: skip
    rows.insert(0 if bare == "first" else len(rows), {"scene": "cave", "method": "naive", LIT: 13.0})
    places = {(row["Scene"], row["Method"]): row["Place"] for row in read(table_of(of(tmp_path, dusk=rows)))}
    assert places == {("attic", "better"): "2", ("attic", "naive"): "1", ("barn", "better"): "2",
                      ("barn", "naive"): "1", ("cave", "naive"): "1"}  # fmt: skip


@pytest.mark.parametrize("up", ["", "../"])
def test_methods_scenes_and_studies_lead_to_their_pages(up: str, tmp_path: Path) -> None:
    table = table_of(of(tmp_path, dusk=dusk(), night=night()), up)
    heads = [column.heading for column in table.columns]
    for row, said in zip(table.rows, read(table), strict=True):
        for kind, links in LINKS.items():
            shown = str(row.cells[heads.index(kind)].text)
            assert shown.startswith(f'<a href="{up}{links[said[kind].rstrip("†")]}">')
        assert "href" not in str(row.cells[heads.index("Light")].text)


def test_a_single_entry_says_its_light_its_camera_and_its_scores_alone(tmp_path: Path) -> None:
    entries = of(tmp_path, dusk=dusk())
    assert read(table_of(entries[2:3])) == [
        {"Place": "1", "Light": "50 electrons", "Camera": "full frame", "PSNR aligned, noise-free": "26.50 ± 0.50"}
    ]


def test_a_table_of_no_entries_has_no_rows() -> None:
    table = table_of([])
    assert [column.heading for column in table.columns] == ["Place"]
    assert table.rows == []
