"""The example of docs/adding-a-camera-source.md finds the cameras of a turntable, in any frame."""

import ast
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.cameras import SOURCES, check_cameras, parse_cameras, spell_cameras
from novags.cameras.align import align
from novags.cameras.estimating import estimate_cameras
from simscenes.rigs import Rig, intrinsics, look_at

PAGE = Path(__file__).resolve().parents[3] / "docs" / "adding-a-camera-source.md"


@pytest.fixture
def source(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's file among the others, and its line in their table."""
    code, line = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
    ((name, row),) = ast.literal_eval(f"{{{line}}}").items()
    module = ModuleType(row.partition(":")[0])
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(code, str(PAGE), "exec"), module.__dict__)
    monkeypatch.setitem(SOURCES, name, row)


@pytest.mark.usefixtures("source")
def test_the_example_of_the_page_is_a_source_of_cameras() -> None:
    """Expectation: of the views that a method trains on, between which the held-out ones are missing."""
    middle, turns = np.array([5.0, -2.0, 1.0]), np.radians(18.0 * np.arange(20) + 17)
    eyes = middle + 3 * np.stack([np.cos(turns), np.sin(turns), np.full(20, 0.4)], -1)
    Ks = np.tile(intrinsics(24, 24, 40.0), (20, 1, 1))
    rig = Rig(viewmats=np.stack([look_at(eye, middle) for eye in eyes]), Ks=Ks, width=24, height=24)
    seen = [i for i in range(20) if i % 8]
    pictures = np.random.default_rng(0).uniform(0, 0.1, (len(seen), 24, 24, 3)).astype(np.float32)

    config = parse_cameras("turntable:step_deg=18,height=0.4")
    check_cameras(config)
    assert spell_cameras(config) == "turntable:step_deg=18.0,height=0.4"
    multiview: Any = SimpleNamespace(rig=rig)
    found = estimate_cameras(config, multiview, seen, torch.from_numpy(pictures), n_points=50)
    fitted = align(found.viewmats, torch.from_numpy(np.asarray(rig.viewmats)[seen]))
    assert fitted.similarity.scale == pytest.approx(3, rel=1e-6)
    assert fitted.rotation_deg.max() < 1e-5
    assert fitted.centre_error.max() < 1e-6
    assert found.points.shape == found.colors.shape == (50, 3)
