"""Claims about further layouts of a set: each that is asked for is checked and written."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.stages import layouts
from novags.testbed.stages.layouts import check_cameras_of, check_layouts, check_source_of, write_layouts


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was checked and written, of layouts of which `deep` alone needs depth."""
    found = list[str]()

    def layout(name: str) -> Any:
        return SimpleNamespace(needs_depth=name == "deep", check=lambda rig: found.append(f"check {name}"),
                               write=lambda views, folder, truth: found.append(f"write {folder.name}"))  # fmt: skip

    monkeypatch.setattr(layouts, "EXPORTS", {name: layout(name) for name in ("flat", "deep", "other")})
    monkeypatch.setattr(layouts, "load_set", lambda folder: None)
    monkeypatch.setattr(layouts.Depths, "of_points", lambda *_: found.append("depth"))
    monkeypatch.setattr(layouts, "replace", lambda views, rig: views)
    return found


@pytest.mark.parametrize("asked", [("flat", "other"), ("other", "deep"), ("deep", "flat")])
def test_every_layout_is_checked_and_written(done: list[str], asked: tuple[str, ...], tmp_path: Path) -> None:
    check_layouts(asked)
    check_cameras_of(asked, None)  # type: ignore[arg-type]
    assert done == [f"check {name}" for name in asked]
    done.clear()
    views = SimpleNamespace(kind="photographs")
    check_source_of(asked, SimpleNamespace(rig=None, views=views, points=lambda: None))  # type: ignore[arg-type]
    assert done == [*(f"check {name}" for name in asked), *(["depth"] if "deep" in asked else [])]
    done.clear()
    write_layouts(tmp_path, asked, Console(quiet=True))
    assert done == [f"write {name}" for name in asked]


def test_an_unknown_layout_is_refused_wherever_it_stands(done: list[str]) -> None:
    with pytest.raises(ValueError, match="export must be among flat, deep, other; got strange, odd"):
        check_layouts(("flat", "strange", "odd"))
