"""Claims about the tables of scores: every run, view, axis and seed has its cell."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.metrics.differences import Estimate
from novags.testbed.report.blocks import scores
from novags.testbed.report.grid import Line
from novags.testbed.report.rows import Row
from novags.testbed.report.study import other_scores


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "named", lambda look: look if isinstance(look, str) else look.name)


def test_a_run_by_itself_has_a_cell_in_every_column() -> None:
    row = {"run": 1, "method": "naive", "level": 5, "state": "done", "a": 1.0, "b": None, "c": 2.5}
    columns = [(name, name, "dB", True, 2) for name in "abc"]
    material: Any = SimpleNamespace(varied=["level"], rows=[row], looks={"naive": "look"}, commands={})
    table = scores._runs(material, columns)
    assert [len(each.cells) for each in table.rows] == [len(table.columns)]


def line(level: int, method: str, *runs: dict[str, Any], **spread: tuple[float, float | None]) -> Line:
    return Line({"level": level, "scene": "s"}, method, list(runs), spread, dict.fromkeys(spread, 2 - (method == "a")))


def look(name: str) -> Row:
    return Row(name, f"key-{name}", name, f"by {name}", "ours", "#102030", None, True, "")


def table_of_many(study: bool = False) -> tuple[dict[str, Any], Any]:
    """Two methods at two levels by two seeds; one run failed, one has no command."""
    column = "enhanced.aligned_psnr"
    runs = [{"run": k + 1, "method": "ab"[k // 2 % 2], "level": k // 4, "scene": "s",
             "state": "failed" if k == 3 else "done", column: 20.0 + k} for k in range(8)]  # fmt: skip
    lines = [line(k // 2, "ab"[k % 2], *runs[2 * k : 2 * k + 2], **{column: (20.0 + k, 0.5)}) for k in range(4)]
    looks = {name: look(name) for name in "ab"}
    material: Any = SimpleNamespace(
        one=None, lines=lines, rows=runs,
        varied=["level"], looks=looks, lost=0, study=(Path("f"), {}) if study else None,
        made={k: SimpleNamespace(name="ab"[k % 2], run=SimpleNamespace(name="ab"[k % 2])) for k in (1, 2)},
        commands={k: None if k == 2 else f"novags {k}" for k in range(1, 9)}, path=Path("g/report.html"),
    )  # fmt: skip
    page: Any = SimpleNamespace(views={(lines[1].where, "b"): "0000"})
    found = scores.scores(material, page)
    return found, list(found["table"].rows)


@pytest.mark.parametrize("study", [False, True])
def test_every_combination_has_its_axes_its_count_and_the_commands_of_all_its_runs(study: bool) -> None:
    found, rows = table_of_many(study)
    assert [row.cells[1].text for row in rows] == ["a", "b", "a", "b"]
    assert [row.cells[2].text for row in rows] == [0, 0, 1, 1]
    assert [row.cells[3].text for row in rows] == ["2", "1 of 2", "2", "2"]
    assert [row.attributes["data-command"] for row in rows] == [
        "novags 1", "novags 3\nnovags 4", "novags 5\nnovags 6", "novags 7\nnovags 8"
    ]  # fmt: skip
    assert [row.attributes["data-view"] for row in rows] == [None, "0000", None, None]
    assert [len(row.cells) for row in rows] == [len(found["table"].columns)] * 4
    assert [column.heading for column in found["table"].columns][:4] == ["#", "Method", "level", "Runs"]
    assert {name for name, _ in found["methods"]} == {"a", "b"}
    assert found["seeds"]
    assert (found["runs"] is not None) == study
    if study:
        assert [row.cells[0].text for row in found["runs"].rows] == list(range(1, 9))
        assert [row.attributes["data-command"] for row in found["runs"].rows][2] == "novags 3"


@pytest.mark.parametrize("last", [0, 1])
def test_what_any_line_has_is_said_of_the_table(last: int, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [line(0, name, {"run": k, "state": "done"}, **{"lit.psnr": (1.0, None)}) for k, name in enumerate("ab")]
    lines[last].runs += [{"run": 5, "state": "done", "linear.psnr": 1.0}]
    lines[last].spread["lit.lpips"] = (0.1, None)
    lines[last].alike = False
    looks = {name: look(name) for name in "ab"}
    material: Any = SimpleNamespace(one=None, lines=lines, rows=[], varied=[], looks=looks, lost=0,
                                    study=None, made={}, commands={}, path=Path("g/report.html"))  # fmt: skip
    found = scores.scores(material, SimpleNamespace(views={}))  # type: ignore[arg-type]
    assert (found["seeds"], found["alike"], found["no_lpips"]) == (True, False, False)
    assert found["in_linear_light"] == ["ab"[last]]


def test_every_held_out_view_has_a_row_with_the_scores_of_every_run() -> None:
    spread = {what: [1.0, None] for what in ("mean", "sd", "worst", "best")}
    of = {"digits": 1, "values": [[20.0, 21.0], [30.0, None], [40.0, 41.0]], "spread": spread}
    found = {"views": ["0000", "0008", "0016"], "methods": ["a", "b"], "scores": {"psnr": of}}
    place: Any = SimpleNamespace(rows={name: SimpleNamespace(name=name) for name in "ab"})
    table = scores._views("lit", found, place)
    assert [(row.cells[0], *(cell.text for cell in row.cells[1:])) for row in table.rows] == [
        ("0000", "20.0", "21.0"), ("0008", "30.0", "unavailable"), ("0016", "40.0", "41.0")
    ]  # fmt: skip
    assert [column.heading for column in table.columns] == ["View", "a", "b"]
    assert [[cell.text for cell in row.cells[1:]] for row in table.foot] == [["1.0", ""]] * 4


def test_every_run_that_is_scored_is_ranked(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = {"key": "aligned_psnr", "value": 20.0, "rank": 1, "best": True, "error": None}
    rows = [{"method": name, "competes": name != "c", "cells": [cell | {"rank": rank}]}
            for name, rank in (("a", 1), ("b", 2), ("c", None))]  # fmt: skip
    monkeypatch.setattr(scores, "table_of", lambda place, kind: rows)
    place: Any = SimpleNamespace(rows={name: SimpleNamespace(name=name) for name in "abc"})
    more = [
        (scores.Column("Over a"), {"b": Estimate(1.5, 0.25, 2.0, "views", 1, 1, 3)}, scores.signed),
        (scores.Column("Recovered"), {"c": Estimate(0.5, None, 0.0, "", 1, 1, 1)}, scores.share),
    ]
    table = scores.ranked_table("lit", place, {"b": "novags b"}, more)
    assert table is not None
    found = list(table.rows)
    assert [(row.cells[0].text, row.cells[1].text) for row in found] == [("1", "a"), ("2", "b"), ("\u2020", "c")]
    assert [[each.text for each in row.cells[-2:]] for row in found] == [
        ["", ""],
        ["+1.50 <small>± 0.25</small>", ""],
        ["", "50 %"],
    ]
    assert [row.attributes["data-command"] for row in found] == [None, "novags b", None]
    assert [column.heading for column in table.columns][-2:] == ["Over a", "Recovered"]


def test_a_shared_place_is_written_so() -> None:
    assert [scores.placed(rank, [1, 1, 3, None], True) for rank in (1, 3, None)] == ["1=", "3", ""]
    assert scores.placed(None, [1], False) == "†"


def test_a_method_with_one_number_takes_a_sentence_and_no_table() -> None:
    row = scores.TableRow(["1", scores.TableCell("raw"), scores.TableCell("56.10"), scores.TableCell("+1.00")])
    shown = [scores.Column(name) for name in ("#", "Method", "PSNR linear", "Over naive")]
    alone = scores.Table("scores-linear", "", shown, [row])
    assert scores._alone("linear", alone) == (
        "raw: PSNR linear 56.10 dB against the noise-free exposure in linear light"
    )
    assert not scores._alone("linear", scores.Table("scores-linear", "", shown, [row, row]))
    assert not scores._alone("lit", alone)  # which has other scores beside it
    assert not scores._alone("linear", None)


@pytest.mark.parametrize(("ranks", "best"), [((1, 2), [True, False]), ((1, 1), [False, False])])
def test_the_best_is_marked_where_another_is_seen_to_be_worse(ranks: tuple[int, int], best: list[bool]) -> None:
    material: Any = SimpleNamespace(looks={name: look(name) for name in "ab"}, commands={})
    column = ("lit.psnr", "PSNR", "dB", True, 2)
    lines = [line(0, name, {"run": 1, "state": "done"}, **{"lit.psnr": (20.0, None)}) for name in "ab"]
    for each, rank in zip(lines, ranks, strict=True):
        each.places["lit.psnr"] = rank
    near = [each.places for each in lines]
    page: Any = SimpleNamespace(views={})
    rows = [scores._line(each, material, page, (), [column], "lit.psnr", near) for each in lines]
    assert ["best" in str(row.cells[-1].attributes) for row in rows] == best
    assert rows[0].cells[0].text == ("1=" if ranks == (1, 1) else "1")


def test_a_line_is_compared_with_all_lines_of_its_place_and_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    near: dict[str, list[int]] = {}
    lines = [line(level, name, {"run": k, "state": "done"}, **{"lit.psnr": (20.0, None)})
             for k, (level, name) in enumerate(((0, "a"), (1, "a"), (1, "b"), (2, "b")))]  # fmt: skip
    for k, each in enumerate(lines):
        each.places["lit.psnr"] = k

    def seen(line: Line, material: Any, page: Any, axes: Any, columns: Any, main: str, places: Any) -> Any:
        near[f"{line.method}{line.place['level']}"] = [each["lit.psnr"] for each in places]
        return scores.TableRow(["", "", "", "", ""])

    monkeypatch.setattr(scores, "_line", seen)
    looks = {name: look(name) for name in "ab"}
    material: Any = SimpleNamespace(one=None, lines=lines, rows=[], varied=["level"], looks=looks, lost=0,
                                    study=None, made={}, commands={}, path=Path("g/report.html"))  # fmt: skip
    scores.scores(material, SimpleNamespace(views={}))  # type: ignore[arg-type]
    assert near == {"a0": [0], "a1": [1, 2], "b1": [1, 2], "b2": [3]}


def test_where_no_score_decides_the_places_are_by_the_first_column() -> None:
    lines = [line(0, name, {"run": k, "state": "done"}, **{"lit.psnr": (20.0, None), "lit.lpips": (0.1, None)})
             for k, name in enumerate("ab")]  # fmt: skip
    lines[0].places["lit.lpips"], lines[1].places["lit.lpips"] = 2, 1  # the other way round
    looks = {name: look(name) for name in "ab"}
    material: Any = SimpleNamespace(one=None, lines=lines, rows=[], varied=[], looks=looks, lost=0,
                                    study=None, made={}, commands={}, path=Path("g/report.html"))  # fmt: skip
    table = scores.scores(material, SimpleNamespace(views={}))["table"]  # type: ignore[arg-type]
    assert [[cell.text for cell in row.cells] for row in table.rows] == [
        ["1", "a", "1", "20.00", "0.100"], ["2", "b", "1", "20.00", "0.100"],
    ]  # fmt: skip


def test_a_line_of_several_axes_has_a_cell_for_each() -> None:
    material: Any = SimpleNamespace(looks={"a": look("a")}, commands={})
    page: Any = SimpleNamespace(views={})
    row = scores._line(line(3, "a", {"run": 1, "state": "done"}), material, page, ("level", "scene"), (), "", [])
    assert [cell.text for cell in row.cells[1:]] == ["a", 3, "s", "1"]


def test_every_kind_of_scores_that_is_missing_is_said_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "ranked_table", lambda *_: None)
    why = {"enhanced": "no clean exposures", "lit": "no lit pictures", "geometry": "not of views"}
    metrics = {"recovered": {}, "recovered_lit": {}, "unavailable": why, "methods": {}}
    place: Any = SimpleNamespace(
        metrics=metrics, deltas=lambda kind: ({}, ""), rows={}, one_reference=True, exposures=(),
        capture=SimpleNamespace(imported=None), lit=SimpleNamespace(views=SimpleNamespace(kind="rendered")),
    )  # fmt: skip
    material: Any = SimpleNamespace(one=place, made={}, commands={})
    found = scores.scores(material, SimpleNamespace(data={}))  # type: ignore[arg-type]
    assert found["unscored"] == ["no clean exposures", "no lit pictures"]


def test_every_kind_of_scores_of_a_place_is_a_table_or_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = {kind: 1 + (kind == "lit") for kind in scores.KINDS}  # methods that have such scores

    def table(kind: str, *rest: Any) -> Any:
        row = scores.TableRow(["1", scores.TableCell("raw"), scores.num(56.1)])
        return scores.Table(kind, "", [], [row] * kinds[kind])

    monkeypatch.setattr(scores, "ranked_table", table)
    monkeypatch.setattr(scores, "columns", lambda kind: [("psnr", kind.upper(), "dB", True)])
    monkeypatch.setattr(scores, "per_view", lambda metrics, kind: None)
    metrics: Any = {"recovered": {}, "recovered_lit": {}, "unavailable": {"lit": "no light", "enhanced": "no truth"}}
    place: Any = SimpleNamespace(
        metrics=metrics, rows={name: look(name) for name in "ab"}, deltas=lambda kind: ({}, ""), one_reference=True,
        exposures={}, capture=SimpleNamespace(imported=None), lit=SimpleNamespace(views=SimpleNamespace(kind="gt")),
    )  # fmt: skip
    page: Any = SimpleNamespace(data={})
    found = scores.scores(SimpleNamespace(one=place, made={}, commands={}), page)  # type: ignore[arg-type]
    assert [kind for kind, shown in found["tables"].items() if shown is not None] == ["lit"]
    assert [said.split()[1] for said in found["alone"]] == [kind.upper() for kind in kinds if kind != "lit"]
    assert sorted(found["unscored"]) == ["no light", "no truth"]
    assert found["methods"] == [("a", "by a"), ("b", "by b")]
    assert set(page.data["looks"]) == {"a", "b"}


def test_rows_that_say_other_scores_than_their_runs_are_found() -> None:
    """Rationale: a number changed by hand in results.json stood in the report as if the run had it."""
    found = {"mean": {"lit": {"psnr": 20.0, "ssim": None}}, "seconds": {"render": 1.0}, "peak_bytes": 7}
    run = SimpleNamespace(run=SimpleNamespace(scores=lambda: found))
    unscored = SimpleNamespace(run=SimpleNamespace(scores=lambda: None))
    own = {"lit.psnr": 20.0, "lit.ssim": None, "seconds.render": 1.0, "peak_bytes": 7, "scene": "a"}
    changed = {"lit.psnr": 23.0}
    told: list[dict[str, float]] = [{}, changed, {"lit.ssim": 0.9}, changed, changed, {"own.score": 3.0}]
    rows = [own | more | {"run": number} for number, more in enumerate(told, 1)]
    made: Any = {1: run, 2: run, 3: run, 4: unscored, 6: run}  # 5 is not on this machine
    assert other_scores(rows, made) == (2, 3)
    del rows[1]["lit.psnr"]  # a table of before the score was there
    assert other_scores(rows, made) == (3,)
