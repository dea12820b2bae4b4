"""Captures of one set by a camera with a mosaic, from dark to bright, and one by three chips; nothing is rendered."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[5]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from novags.testbed.console.terminal import Console  # noqa: E402
from novags.testbed.dataset.recipes.recipe import Group, opened_group  # noqa: E402
from novags.testbed.stages import capture  # noqa: E402
from novags.testbed.stages.configs.capturing import CaptureConfig, OwnNoiseConfig  # noqa: E402
from tests.fuzz.readers.records import make_set  # noqa: E402

MOSAIC, CHIPS = "a7s2-iso6400", "a7s2-iso6400-3chip"
LIGHT = (2000.0, 1.0, 20.0)  # e-, not in order


def taken(folder: Path, name: str, config: CaptureConfig) -> Path:
    capture(folder / "set", folder / name, config, Console(quiet=True))
    return folder / name


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """set/ of five views, m0/ m1/ m2/ of a mosaic by `LIGHT`, and chips/ of three chips at 5 e-."""
    made = tmp_path_factory.mktemp("recipes")
    (made / "set").mkdir()
    make_set(made / "set", views=5)
    for k, electrons in enumerate(LIGHT):
        taken(made, f"m{k}", OwnNoiseConfig(sensor=MOSAIC, electrons=electrons, drawn=10 + k))
    taken(made, "chips", OwnNoiseConfig(sensor=CHIPS, electrons=5.0, drawn=20))
    return made


@pytest.fixture
def mosaic(folder: Path) -> Group:
    """The captures of the mosaic."""
    return opened_group([folder / f"m{k}" for k in range(len(LIGHT))], folder / "set")


@pytest.fixture
def chips(folder: Path) -> Group:
    """The capture of three chips."""
    return opened_group([folder / "chips"], folder / "set")
