"""Claims about an import of pictures beside their raw files: every file of both is looked at."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.importing.darkroom import SMALL, Darkroom
from novags.testbed.stages import importing
from novags.testbed.stages.configs.importing import ImportConfig
from simscenes.sets.pictures.png import write_png

QUIET = Console(quiet=True)


class Views(list[str]):
    path = Path("somewhere")
    lit_alone = ()

    @property
    def names(self) -> list[str]:
        return [*self]


def material(*names: str, raws: tuple[str, ...] = ()) -> Any:
    dark = SimpleNamespace(
        source=SimpleNamespace(views=Views(names), rig=SimpleNamespace(width=40, height=30)), depth="8bit",
        files=tuple(map(Path, names)), dark_files=tuple(map(Path, names)), raws=tuple(map(Path, raws)), beside={},
    )  # fmt: skip
    return SimpleNamespace(dark=dark, lit=None, clean=None, dataset=None)


def test_every_picture_and_every_raw_file_is_read_before_anything_is_cleared(monkeypatch: pytest.MonkeyPatch) -> None:
    checked = list[str]()
    darkroom = SimpleNamespace(check=lambda file, lit: checked.append(file.name) or ("8bit", False))
    monkeypatch.setattr(importing, "Darkroom", lambda **_: darkroom)
    monkeypatch.setattr(importing, "raw_camera", lambda *_: None)
    monkeypatch.setattr(importing, "check_exposed_alike", lambda *_: None)
    monkeypatch.setattr(importing, "_say", lambda *_: None)
    importing.prepare(material("a.png", "b.png", raws=("a.dng", "b.dng")), ImportConfig(), QUIET)
    assert checked == ["a.png", "b.png", "a.dng", "b.dng"]


@pytest.mark.parametrize(("names", "lossy"), [(("a.png", "b.jpg"), True), (("a.jpg", "b.png"), True),
                                              (("a.png", "b.png"), False)])  # fmt: skip
def test_a_picture_that_lost_something_is_recorded_whichever_it_is(
    names: tuple[str, ...], lossy: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = material(*names)
    monkeypatch.setattr(importing, "files_of", lambda source: {})
    darkroom = SimpleNamespace(camera=None, resampled=False, rig=found.dark.source.rig)
    prepared: Any = SimpleNamespace(darkroom=darkroom, match=None, resampled=0)
    assert importing.record_of(found, prepared, ImportConfig())["jpeg"] is lossy


@pytest.mark.parametrize(("width", "height", "times"), [(96, 48, 4), (40, 120, 5), (20, 10, 1)])
def test_pictures_are_compared_small_in_their_own_shape(width: int, height: int, times: int, tmp_path: Path) -> None:
    """Expectation: the mean of squares of pixels and of their channels, on the longest side 24 px at most."""
    codes = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    write_png(tmp_path / "a.png", codes)
    nothing: Any = None
    views: Any = SimpleNamespace(rig=SimpleNamespace(width=width, height=height))
    darkroom = Darkroom(views=views, rig=views.rig, codes=nothing, lit_codes=nothing, camera=None, lit_colors=None)
    small = codes.reshape(height // times, times, width // times, times, 3).mean((1, 3, 4))
    assert max(small.shape) <= SMALL
    np.testing.assert_allclose(darkroom.small(tmp_path / "a.png"), small, rtol=1e-5)
