"""Claims about losses over the iterations."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.report.blocks import training as module
from novags.testbed.report.blocks.training import fits, losses, smoothed, training


def test_fits_of_one_run_stand_one_after_the_other() -> None:
    counted = [(10, 5.0), (20, 4.0), (10, 3.0), (10, 2.0), (40, 1.0)]
    assert fits(counted) == [[(10, 5.0), (20, 4.0)], [(30, 3.0)], [(40, 2.0), (70, 1.0)]]
    assert fits([]) == []


def test_smoothing_keeps_the_mean_and_the_end() -> None:
    points = [(float(k), float(k % 7)) for k in range(1, 1001)]
    few = smoothed(points, count=100)
    assert len(few) == 100
    assert few[-1][0] == 1000
    assert np.mean([y for _, y in few]) == pytest.approx(np.mean([y for _, y in points]))


def test_the_losses_of_every_run_are_drawn_over_all_their_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    """The run that logged nothing is left out, and the axes hold the points of all others."""
    logged = {"a": [(10, 0.5), (20, 0.25)], "none": [], "b": [(10, 2.0), (400, 0.01), (10, 8.0), (300, "nan")]}
    runs = {
        name: SimpleNamespace(
            events=lambda points=points: [{"iteration": k, "photometric": loss} for k, loss in points] + [{"step": 1}]
        )
        for name, points in logged.items()
    }
    place = SimpleNamespace(runs=runs, rows={name: SimpleNamespace(key=f"key-{name}") for name in logged})
    drawn = list[Any]()
    monkeypatch.setattr(module, "Chart", lambda *a: drawn.append(a) or SimpleNamespace(svg=lambda: "svg"))
    found = training(SimpleNamespace(one=place), None)  # type: ignore[arg-type]
    assert found == {"chart": "svg", "key": [("a", "key-a"), ("b", "key-b")]}
    ((_, x, y, series),) = drawn
    points = {each.name: [(p.x, p.y) for p in each.points if p.y == p.y] for each in series}
    assert points == {"a": [(10, 0.5), (20, 0.25)], "b": [(10, 2.0), (400, 0.01), (410, 8.0)]}
    assert (x.low, x.high) == (0.0, 410.0)
    assert y.low <= np.log10(0.01)
    assert y.high >= np.log10(8.0)


def test_a_fit_whose_last_loss_is_not_finite_is_drawn_up_to_there() -> None:
    events = [{"iteration": k, "photometric": loss} for k, loss in ((10, 0.5), (20, "nan"))]
    place = SimpleNamespace(runs={"a": SimpleNamespace(events=lambda: events)}, rows={"a": SimpleNamespace(key="key")})
    found = training(SimpleNamespace(one=place), None)  # type: ignore[arg-type]
    assert found is not None
    assert found["key"] == [("a", "key")]


def test_a_chart_of_losses_holds_the_first_and_the_last_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = list[Any]()
    monkeypatch.setattr(module, "Chart", lambda *a: drawn.append(a) or SimpleNamespace(svg=lambda: "svg"))
    losses({"a": [(10, 8.0), (20, 2.0), (30, 0.5)]}, {"a": "key"})
    ((_, x, y, (series,)),) = drawn
    assert [(point.x, point.y) for point in series.points] == [(10, 8.0), (20, 2.0), (30, 0.5)]
    assert x.high == 30
    assert y.low < np.log10(0.5) < np.log10(8.0) < y.high


def test_a_page_without_losses_has_no_such_block() -> None:
    place = SimpleNamespace(runs={"a": SimpleNamespace(events=list)}, rows={})
    assert training(SimpleNamespace(one=place), None) is None  # type: ignore[arg-type]
