"""On which files the cameras of photographs depend."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.stages import posing
from novags.testbed.stages.configs.posing import PosesConfig
from novags.testbed.study.plan import Planner
from simscenes.sets.pictures.png import write_png

QUIET = Console(quiet=True)


def picture(file: Path, seed: int) -> None:
    write_png(file, np.random.default_rng(seed).integers(0, 255, (8, 8, 3)).astype(np.uint8))


def of_stage(photos: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    class Asked(Exception):
        pass

    def asked(*_: Any, inputs: Any, **__: Any) -> None:
        raise Asked(inputs())

    monkeypatch.setattr(posing, "run_stage", asked)
    with pytest.raises(Asked) as found:
        posing.poses(photos.parent / "set", PosesConfig(photographs=photos), QUIET)
    return found.value.args[0]


def of_plan(photos: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    return Planner(photos.parent / "store", QUIET)._posed(PosesConfig(photographs=photos))


@pytest.mark.parametrize("asked", [of_stage, of_plan])
def test_photographs_alone_and_all_of_them_decide_whether_cameras_are_found_again(
    asked: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos = tmp_path / "photos"
    for k in range(4):
        picture(photos / f"{k}.png", k)
    first = asked(photos, monkeypatch)
    (tmp_path / "beside.txt").write_text("no photograph")
    (photos / "notes.txt").write_text("no photograph")
    assert asked(photos, monkeypatch) == first
    found = [first]
    for k, seed in ((3, 9), (0, 8)):
        picture(photos / f"{k}.png", seed)
        found.append(asked(photos, monkeypatch))
    picture(photos / "4.png", 4)
    found.append(asked(photos, monkeypatch))
    assert len({str(each) for each in found}) == 4
