"""Claims about scores along fits: every run of every method counts, at every length."""

from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.report.blocks import length as module
from novags.testbed.report.blocks.length import length
from novags.testbed.report.parts import TableRow

END = 40


def made(name: str, psnr: dict[int, float], stop: int | None = None) -> SimpleNamespace:
    """A run with these scores by iterations, of which it would have stopped itself at one."""
    means = {at: {"lit": {"tone_aligned_psnr": value}} for at, value in psnr.items()}
    along = [{"iterations": at, "mean": mean} for at, mean in means.items() if at != END]
    scores = {"along": along, "mean": means[END]}
    if stop is not None:
        scores["held_out"] = {"psnr": {str(at): 1.0 for at in psnr}, "stop": stop}
    run = SimpleNamespace(name=name, iterations=END, scores=lambda: scores, along=lambda: along)
    return SimpleNamespace(run=run)


def texts(row: TableRow) -> list[str]:
    return [getattr(cell, "text", cell) for cell in row.cells]


def test_every_run_of_every_method_counts_at_every_length(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [
        made("a", {10: 20.0, 20: 24.0, END: 22.0}, stop=20), made("a", {10: 22.0, 20: 28.0, END: 20.0}, stop=10),
        made("never shown before its end", {END: 30.0}), made("b", {10: 10.0, 20: 14.0, END: 14.0}),
        made("b", {10: 12.0, 20: 12.0, END: 18.0}),
    ]  # fmt: skip
    looks = {each.run.name: SimpleNamespace(key=f"key-{each.run.name}") for each in runs}
    material: Any = SimpleNamespace(made=dict(enumerate(runs)), looks=looks, called=lambda each: each.run.name)
    drawn = list[Any]()
    monkeypatch.setattr(module, "Chart", lambda *a: drawn.append(a) or SimpleNamespace(svg=lambda: "svg"))
    found = length(material, None)  # type: ignore[arg-type]
    assert found is not None
    assert found["key"] == [("a", "key-a"), ("b", "key-b")]
    (kind,) = found["kinds"]
    assert [column.heading for column in kind["table"].columns] == [
        "Method", "10", "20", "40", "Best length", "There above the end",
    ]  # fmt: skip
    assert list(map(texts, kind["table"].rows)) == [
        ["a", "21.00", "26.00", "21.00", "20", "5.00"], ["b", "11.00", "13.00", "16.00", "40", "0.00"],
    ]  # fmt: skip
    ((_, x, y, series),) = drawn
    assert {each.name: [(p.x, p.y) for p in each.points] for each in series} == {
        "a": [(10, 21.0), (20, 26.0), (40, 21.0)], "b": [(10, 11.0), (20, 13.0), (40, 16.0)],
    }  # fmt: skip
    assert tuple(x.ticks) == (10, 20, 40)
    assert y.low < 11 < 26 < y.high
    # At their ends 22 and 20, at their own stops 24 and 22, at their best 24 and 28, which are 0 and 6 above the stops.
    (row,) = kind["three"].rows
    assert texts(row) == ["a", "2", "21.00", "23.00", "26.00", "10 to 20", "3.00"]
