"""Claims about the effects that a page tells of: those of all plans together."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.report import material
from novags.testbed.report.blocks import simulated
from novags.testbed.report.blocks.simulated import effects, render_quality


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


def effect(name: str, on: bool, cost: Any = 0.0, reason: str = "r", *, forced: bool = False) -> dict[str, Any]:
    return {
        "name": name,
        "on": on,
        "contribution": cost,
        "bound": 0.5,
        "unit": "codes",
        "reason": reason,
        "forced": forced,
    }


def plan(*effects: dict[str, Any], bound: float = 0.1, **biases: float) -> dict[str, Any]:
    return {"effects": list(effects), "bound": bound, "unit": "codes", "biases": biases}


def test_every_plan_counts_in_the_effects_and_in_what_leaving_them_out_costs() -> None:
    """The first plan has the largest bound in codes, and neither the largest cost nor all of the effects."""
    plans = [
        plan(effect("read_noise", True, 1.0), effect("fog", False), bound=0.75),
        plan(effect("read_noise", False, 2.0, "q"), effect("fog", False), effect("glass", False, 3.0), noise=0.5),
        plan(effect("read_noise", False, 4.0), effect("fog", False), effect("glass", True, forced=True), bound=0.25,
             noise=0.125),
    ]  # fmt: skip
    made = {k: SimpleNamespace(set=Path("s"), rendered={}, capture=Path(f"{k}"), captured={"plan": each})
            for k, each in enumerate(plans)}  # fmt: skip
    (found,) = effects(SimpleNamespace(made=made, one=None))  # type: ignore[arg-type]
    assert found["heading"] == "Sensor"
    cells = [[str(getattr(cell, "text", cell)) for cell in row.cells] for row in found["table"].rows]
    assert [(row[0], row[2], row[5]) for row in cells] == [("read noise", "4.0000", ""), ("glass", "3.0000", "r")]
    assert ["1 of 3" in cells[0][1], "1 of 2" in cells[1][1], "forced" in cells[1][1]] == [True, True, True]
    assert found["told"] == ("Without effect here: fog. Everything that was left out costs at most 0.7500 (codes), "
                             "0.5000 (noise).")  # fmt: skip


def test_the_noise_of_a_render_is_that_of_its_worst_view_and_fireflies_are_of_all() -> None:
    views = {"a": (0.01, 1), "b": (0.05, 2), "c": (0.02, 3)}
    meta = {"views": {name: {"relative_error": error, "fireflies": count} for name, (error, count) in views.items()},
            "width": 10, "height": 20}  # fmt: skip
    assert "at most 5.0% of a view's" in render_quality(meta)
    assert "6 pixels (1.00%) are fireflies" in render_quality(meta)
