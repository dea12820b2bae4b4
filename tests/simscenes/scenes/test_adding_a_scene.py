"""The example of docs/adding-a-scene.md is a scene that the catalogue would accept."""

import ast
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simscenes import scenes
from simscenes.backend import activate
from simscenes.loading.load import build_scene
from simscenes.render.geometry import geometry_channels

PAGE = Path(__file__).resolve().parents[3] / "docs" / "adding-a-scene.md"


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's file and line, in the catalogue for the length of a test."""
    code, row = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
    ((name, reference),) = ast.literal_eval(f"{{{row}}}").items()
    module = ModuleType(reference.partition(":")[0])
    exec(compile(code, str(PAGE), "exec"), vars(module))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(scenes.SCENES, name, reference)


@pytest.mark.usefixtures("added")
def test_the_example_is_framed_and_varies_with_its_seed() -> None:
    mi = activate()
    loaded = build_scene("shelf", mi)
    rig = scenes.default_rig("shelf", 4, 32, 32)
    views = [geometry_channels(mi, loaded, rig, i) for i in range(4)]
    assert min((view["id"] > 0).mean() for view in views) > 0.99
    size = float(np.linalg.norm(np.array(loaded.scene.bbox().extents())))
    assert min(view["Z"].min() for view in views) > 0.02 * size
    pots = {loaded.scene.shapes()[i].id() for view in views for i in np.unique(view["id"])[1:].astype(int) - 1}
    assert {"pot_0", "pot_1", "pot_2", "board"} <= pots
    assert build_scene("shelf:1", mi).digest != loaded.digest == build_scene("shelf", mi).digest
