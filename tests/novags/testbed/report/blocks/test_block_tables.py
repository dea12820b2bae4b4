"""Tables of a page hold all that they are told, and not the first of it alone."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.report import material
from novags.testbed.report.blocks import cost, light, scores, simulated
from novags.testbed.report.grid import Line, shown_columns
from novags.testbed.report.tables import per_view


def test_a_column_that_any_line_has_a_value_in_is_shown() -> None:
    lines = [Line({}, "a", []), Line({}, "b", [], {"enhanced.flip": (0.2, None)})]
    assert [column[0] for column in shown_columns(lines)] == ["enhanced.flip"]


def test_a_score_that_a_later_view_has_alone_is_told_of_all_views() -> None:
    views = {"0": {"lit": {"psnr": None}}, "1": {"lit": {"psnr": 20.0}}, "2": {"lit": {"psnr": 30.0}}}
    found = per_view({"methods": {"naive": {"mean": {"lit": {"psnr": 25.0}}, "views": views}}}, "lit")
    assert found is not None
    assert found["scores"]["psnr"]["values"] == [[None], [20.0], [30.0]]
    assert found["scores"]["psnr"]["spread"]["mean"] == [25.0]


@pytest.mark.parametrize("counts", [(1, 1), (1, 3), (2, 1)])
def test_every_stage_has_a_row_and_any_that_was_done_often_a_count(
    counts: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [{"label": f"stage {i}", "count": count, "seconds": 3.0, "peak": 1e6, "parts": {}, "look": "", "bar": 1.0,
             "share": 0.5} for i, count in enumerate(counts)]  # fmt: skip
    monkeypatch.setattr(cost, "costs", lambda _: rows)
    monkeypatch.setattr(cost, "mixed", lambda _: [])
    run = SimpleNamespace(name="a", run=SimpleNamespace(record={"stage": {"hardware": {}}}))
    material: Any = SimpleNamespace(made={1: run}, one=None)
    found = cost.cost(material, None)  # type: ignore[arg-type]
    assert found is not None
    assert [row.cells[0] for row in found["table"].rows] == [row["label"] for row in rows]
    assert len(found["table"].columns) == (6 if max(counts) > 1 else 4)
    assert found["shared"] == (max(counts) > 1)


def test_every_curve_that_breaks_has_a_row_in_words() -> None:
    knees = [{"method": name, "measure": "psnr", "electrons": 3.0, "low": None, "high": None, "seeds": 2, "unknown": k}
             for k, name in enumerate(("a", "b", "c"))]  # fmt: skip
    curve: Any = SimpleNamespace(measure=SimpleNamespace(key="psnr", label="PSNR"))
    table = light._table(knees, [curve])
    assert table is not None
    assert [str(row.cells[0]) for row in table.rows] == ["a", "b", "c"]
    assert {str(row.cells[1]) for row in table.rows} == {"PSNR"}
    assert [str(row.cells[3]) for row in table.rows] == ["not reached", "not reached", "unknown"]


def test_a_run_by_itself_has_a_cell_in_every_column(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "named", lambda look: look)
    row = {"run": 1, "method": "naive", "level": 5, "state": "done", "a": 1.0, "b": None, "c": 2.5}
    columns = [(name, name, "dB", True, 2) for name in "abc"]
    material: Any = SimpleNamespace(varied=["level"], rows=[row], looks={"naive": "look"}, commands={})
    table = scores._runs(material, columns)
    assert [len(each.cells) for each in table.rows] == [len(table.columns)]


def test_photographs_without_a_camera_are_counted_beside_the_views_of_the_capture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def place(lost: list[str], views: int) -> Any:
        return SimpleNamespace(
            runs={}, metrics={"unavailable": {}}, capture=SimpleNamespace(record=SimpleNamespace(views=views)),
            lit=SimpleNamespace(views=SimpleNamespace(unregistered=lost)),
        )  # fmt: skip

    places = {"a": place(["x.png", "y.png"], 8), "b": place([], 3), "c": place(["z.png"], 5)}
    monkeypatch.setattr(material, "titles", lambda *_: list(places))
    monkeypatch.setattr(material, "_rows", lambda _: [])
    found = material.material_of(list(places.values()), Path("report.html"))
    assert found.unregistered == {"a": (["x.png", "y.png"], 8), "c": (["z.png"], 5)}
    monkeypatch.setattr(simulated, "effects", lambda _: None)
    said = simulated.simulated(found, None)  # type: ignore[arg-type]
    assert said is not None
    assert [text.partition(",")[0] for text in said["missing"]] == [
        "No camera was found for 2 of 10 photographs of a", "No camera was found for 1 of 6 photographs of c",
    ]  # fmt: skip
