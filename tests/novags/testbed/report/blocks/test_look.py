"""Claims about the pictures of a page: every place, view and run has its own."""

from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.report.blocks import look as module
from novags.testbed.report.blocks.look import look, short_names, strip_of


def test_views_are_called_by_what_tells_them_apart() -> None:
    def names(*views: tuple[str, bool]) -> list[str]:
        return short_names([SimpleNamespace(name=name, held_out=held_out) for name, held_out in views])  # type: ignore[misc]

    assert names(("0000", True), ("0008", True), ("0001", False)) == ["0000 · held out", "0008 · held out",
                                                                     "0001 · training"]  # fmt: skip
    long = "set, {} electrons, a7s2-iso6400-3chip, view {}"
    assert names((long.format(5, "0000"), True), (long.format(20, "0000"), True)) == ["5 electrons", "20 electrons"]
    assert names(("0000", True)) == ["0000 · held out"]


def test_the_film_strip_goes_from_the_dark_to_the_truth_as_far_as_pictures_are_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "compared", lambda place: ("render-naive", "render-nova"))
    monkeypatch.setattr(module, "leading", lambda place: ("enhanced", "", ""))

    def shown(*keys: str) -> list[str]:
        view: Any = SimpleNamespace(tiles=[SimpleNamespace(key=key) for key in keys])
        return [tile.key for tile in strip_of(SimpleNamespace(), view).tiles]  # type: ignore[arg-type]

    every = ("truth-lit", "truth-enhanced", "render-nova", "other", "dark", "render-naive")
    assert shown(*every) == ["dark", "render-naive", "render-nova", "truth-enhanced"]
    assert shown("truth-lit", "render-nova", "dark") == ["dark", "render-nova", "truth-lit"]
    assert shown("render-nova") == ["render-nova"]


RUNS = {"one": ("a", "b"), "two": ("b", "c")}


def test_every_view_of_every_place_is_shown_and_every_run_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def tiles(i: int, place: Any, album: Any, called: str) -> Any:
        keys = [*(f"render-{run}" for run in place.runs), f"{called}{i}-x"]
        keys = keys[::-1] if called == "one" else keys
        return SimpleNamespace(name=f"{called} {i}", held_out=i == 3, tiles=[SimpleNamespace(key=key) for key in keys])

    monkeypatch.setattr(module, "view_tiles", tiles)
    monkeypatch.setattr(module, "compared", lambda place: tuple(f"render-{run}" for run in place.runs))
    monkeypatch.setattr(module, "leading", lambda place: None)
    places = {name: lambda runs=runs: SimpleNamespace(runs=runs, views=[3, 5]) for name, runs in RUNS.items()}

    def broken() -> None:
        raise ValueError("it is gone")

    said = list[tuple[int, int]]()
    page: Any = SimpleNamespace(
        album=None, views={}, data={}, strip=None, progress=lambda done, of, what: said.append((done, of))
    )
    material: Any = SimpleNamespace(
        one=None, unseen={"old": "why"}, places={**places, "three": broken, "no": lambda: None}
    )
    found = look(material, page)
    assert found is not None
    assert [view.name for view in found["views"]] == ["one 3", "one 5", "two 3", "two 5"]
    assert page.views == {(name, run): f"{name} 3" for name, runs in RUNS.items() for run in runs}
    assert (page.data["left"], page.data["right"]) == (
        ["render-a", "render-b", "enhanced"], ["render-b", "render-c", "truth-lit"]
    )  # fmt: skip
    assert (page.strip.view.name, page.strip.keys) == ("one 3", {"render-a", "render-b"})
    assert found["kinds"] == {"render", "one3", "one5", "two3", "two5"}
    assert found["unseen"] == {"old": "why", "three": "it is gone"}
    assert said == [(1, 8), (2, 8), (3, 8), (4, 8)]
