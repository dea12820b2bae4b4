"""Claims about where `novags doctor --stability --out` writes: it is refused or made before anything is computed."""

from pathlib import Path
from typing import Any

import pytest

from novags.testbed import stability
from novags.testbed.stability import Part
from novags.testbed.stability.console import show


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What was computed of a part that costs nothing."""
    settings: list[Any] = []
    part = Part("free")
    part.case("a case", bound=1.0, unit="relative")(lambda setting: settings.append(setting) or 0.5)
    monkeypatch.setitem(stability.PARTS, "free", part)
    return settings


def test_the_table_is_written_into_a_folder_that_was_not_there(computed: list[Any], tmp_path: Path) -> None:
    assert show(("free",), out=tmp_path / "new" / "x.md")
    assert "| a case | 0.5 |" in (tmp_path / "new" / "x.md").read_text()
    assert computed


@pytest.mark.parametrize("place", ["", "file/x.md"])
def test_a_place_for_the_table_that_cannot_be_is_refused_before_any_case(
    computed: list[Any], tmp_path: Path, place: str
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises((ValueError, FileExistsError, NotADirectoryError)):
        show(("free",), out=tmp_path / place)
    assert not computed
