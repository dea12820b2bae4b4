"""Claims about how a study connects to Ray, without a cluster."""

import os
import sys
from pathlib import Path
from types import ModuleType

import pytest

from novags.testbed.study.engines.cluster import connected


def test_ray_is_started_away_from_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: Ray puts the working directory first in `sys.path` of all its workers; a `torch.py` may lie there."""
    started: list[str] = []
    stand_in = ModuleType("ray")
    monkeypatch.setattr(stand_in, "init", lambda **_: started.append(os.getcwd()), raising=False)
    monkeypatch.setattr(stand_in, "shutdown", lambda: None, raising=False)
    monkeypatch.setitem(sys.modules, "ray", stand_in)
    monkeypatch.chdir(tmp_path)
    with connected(None):
        assert Path.cwd() == tmp_path
    assert started == [os.sep]
