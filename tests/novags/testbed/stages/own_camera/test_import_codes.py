"""Claims about the codes of 16-bit photographs, on what `novags import` says of them."""

import io
import shutil
from pathlib import Path

import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.importing import stored
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.importing import import_photographs
from simscenes.sets.pictures.png import read_png, write_png

SAYS = ", as the files say"


@pytest.mark.parametrize(
    ("place", "said"),
    [(None, "linear in between"), (-1, f"linear or srgb in between{SAYS}"), (0, f"srgb or linear in between{SAYS}")],
)
def test_files_that_state_other_curves_than_their_neighbours_are_named(
    place: int | None, said: str, photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: each is read by its own, and a folder of both kinds is likely a mistake."""
    dark = shutil.copytree(photographs, tmp_path / "dark")
    files = sorted((dark / "images").iterdir())
    for file in files:
        write_png(file, 80 * np.round(255 * read_png(file)).astype(np.uint16))
    others = [] if place is None else [files[place].name]
    monkeypatch.setattr(stored, "stated_curve", lambda file: "srgb" if file.name in others else None)
    stream = io.StringIO()
    import_photographs(dark, tmp_path / "cap", ImportConfig(), Console(stream=stream))
    assert f"white, {said} (" in stream.getvalue()
