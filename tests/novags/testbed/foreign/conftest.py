"""A tiny capture of photographs, made in a second; tests must not change it."""

from pathlib import Path

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.stages.configs.capturing import CaptureConfig
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

NAMES = [f"{i:04d}" for i in range(9)]


@pytest.fixture(scope="session")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, rng = tmp_path_factory.mktemp("foreign") / "photos", np.random.default_rng(0)
    write_cameras(folder, NAMES, orbit_rig(9, 32, 24, 50.0, radius=3.0))
    for name in NAMES:
        blocks = rng.integers(20, 250, (6, 8, 3)).astype(np.uint8)
        write_png(folder / "images" / f"{name}.png", blocks.repeat(4, 0).repeat(4, 1))
    return folder


@pytest.fixture(scope="session")
def capture(photographs: Path) -> Path:
    out = photographs.parent / "capture"
    stages.capture(photographs, out, CaptureConfig(electrons=200.0), Console(quiet=True))
    return out
