"""Two tiny runs of one capture of photographs; tests must not change them."""

from pathlib import Path

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png
from tests.miniatures import unsealed

QUIET = Console(quiet=True)
NAMES = [f"{i:04d}" for i in range(9)]
WIDTH, HEIGHT = 64, 48


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Of coloured blocks, at 50 electrons; the second has denoised pictures, which are made up.

    They hold no checksums, as those of earlier versions, so that tests can change copies of them.
    """
    folder, rng = tmp_path_factory.mktemp("viewed"), np.random.default_rng(0)
    write_cameras(folder / "photos", NAMES, orbit_rig(9, WIDTH, HEIGHT, 50.0, radius=3.0))
    for name in NAMES:
        blocks = rng.integers(20, 250, (6, 8, 3)).astype(np.uint8)
        write_png(folder / "photos" / "images" / f"{name}.png", blocks.repeat(8, 0).repeat(8, 1))
    stages.capture(folder / "photos", folder / "capture", CaptureConfig(electrons=50.0, seed=3), QUIET)
    for name, method in (("first", "naive"), ("second", "naive-l1")):
        short = adapted(EXPERIMENTS["demo"], methods=(method,), points=80, iterations=10)
        stages.reconstruct(folder / "capture", folder / name, short.reconstruct(method), QUIET)
        unsealed(folder / name / "run.json")
    for name in NAMES[1:8]:
        write_png(folder / "second" / "denoised" / f"{name}.png", np.full((HEIGHT, WIDTH, 3), 0.25, np.float32))
    return {name: folder / name for name in ("capture", "first", "second")}
