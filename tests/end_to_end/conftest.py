"""One tiny experiment, shared by the tests of the whole line."""

from pathlib import Path

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.report.page import write_report
from novags.testbed.study.cells.presets import EXPERIMENTS, Preset, adapted
from novags.testbed.study.place import run


@pytest.fixture(scope="session")
def tiny() -> Preset:
    return adapted(
        EXPERIMENTS["demo"],
        scene="cornell",
        n_views=9,
        width=24,
        height=24,
        spp=8,
        points=300,
        iterations=30,
        denoiser_steps=5,
        methods=("nova-fast", "naive", "oracle"),
    )


@pytest.fixture(scope="session")
def quiet() -> Console:
    return Console(quiet=True)


@pytest.fixture(scope="session")
def experiment(tmp_path_factory: pytest.TempPathFactory, tiny: Preset, quiet: Console) -> Path:
    """A finished experiment; tests must not change it."""
    folder = tmp_path_factory.mktemp("experiment with spaces")
    run(tiny, folder, quiet, report=write_report, command="novags run")
    return folder
