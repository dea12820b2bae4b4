"""What tests of several parts share, and what not every machine has: said once, and why lacking it is not a failure."""

import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from novags.process import settle
from sensor_model.files.own import cache_folder
from simscenes.backend import backend_status

# Tests that give a command a home of its own would compile every kernel in it.
os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_folder("kernels").parent))
settle()  # before torch is loaded: what tests compute in this process has the bits that commands and workers compute
pytest_plugins = ["novags.testing", "pytester"]

PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "ci")
MORE = 100  # times as many examples in the long profile

settings.register_profile("ci", derandomize=True, deadline=None, max_examples=25)
settings.register_profile(
    "long", deadline=None, max_examples=25 * MORE, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)
settings.load_profile(PROFILE)

# A shell that starts a job in the background makes it deaf to Ctrl-C, and all that it starts; some tests press it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """In the long profile, property tests that say how many examples they take, and which, take others and more."""
    if PROFILE == "long":
        for item in items:
            test = getattr(item, "obj", None)
            own = getattr(test, "_hypothesis_internal_use_settings", None)
            if own is not None and own.max_examples != settings.default.max_examples:
                more = settings(own, max_examples=MORE * own.max_examples, derandomize=False)
                test._hypothesis_internal_use_settings = more


DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.fixture(scope="session")
def blocks() -> Callable[[str, str], list[str]]:
    """A function (page, language) -> the blocks of code in a page of docs/, in order."""

    def of(page: str, language: str = "python") -> list[str]:
        text = (DOCS / page).read_text(encoding="utf-8")
        return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)

    return of


FOX = Path(__file__).resolve().parents[2] / "shared" / "data" / "fox"


@pytest.fixture(scope="session")
def fox() -> Path:
    """A folder of fifty real photographs with a transforms.json."""
    if not FOX.is_dir():
        # They are other people's, so they lie beside a checkout and are never part of it: a stranger's clone has none.
        # What they show is tested there on folders that the tests write.
        pytest.skip("the fox photographs are not beside this checkout")
    return FOX


@pytest.fixture(scope="session")
def jit() -> None:
    """A Mitsuba variant that compiles kernels for whole arrays of rays."""
    if not (backend_status("llvm_ad")[0] or backend_status("cuda_ad")[0]):
        # Where nobody may install libLLVM, novags renders with a scalar variant: that is slow but allowed, and this
        # machinery then has no part in it. Everything else is tested there too.
        pytest.skip(f"only scalar Mitsuba variants work here: {backend_status('llvm_ad')[1]}")


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """A function that runs `novags` with its words in this process, and returns the exit code."""

    def run(*words: str) -> int:
        from novags import cli

        monkeypatch.setattr(sys, "argv", ["novags", *words])
        monkeypatch.setattr("signal.signal", lambda *_: None)  # pytest keeps its own handlers
        try:
            cli.main()
        except SystemExit as stop:
            return int(stop.code or 0)
        return 0

    return run


@pytest.fixture
def one_core() -> Iterator[None]:
    """One core for this process and all that it starts: the threads of a study wait for each other on busy cores, and
    spin meanwhile, so that it computes twice as long.
    """
    if not hasattr(os, "sched_setaffinity"):  # elsewhere than on Linux it takes as long as it takes
        yield
        return
    cores = sorted(before := os.sched_getaffinity(0))
    number = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    os.sched_setaffinity(0, {cores[number % len(cores)]})
    yield
    os.sched_setaffinity(0, before)


BALL = """<scene version="3.0.0">
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
  </sensor>
  <emitter type="constant"/>
  <shape type="sphere"/>
</scene>
"""
# The smallest experiment that every stage takes, as lines of a study file.
SMALLEST = """
[override]
views = 4
width = 24
height = 24
spp = 4
points = 60
iterations = 20
render.variant = "scalar"
"""


@pytest.fixture(scope="session")
def ball_xml() -> str:
    """A scene file that renders fast with every variant of Mitsuba: a white ball before a camera, in white light."""
    return BALL


@pytest.fixture(scope="session")
def smallest() -> str:
    return SMALLEST


@pytest.fixture(scope="session")
def without_costs() -> Callable[[Any], Any]:
    """A function that leaves out of a record all that differs from one time to the next."""
    from novags.testbed.ledger.contents import VOLATILE

    costs = {*VOLATILE, "hardware", "date"} - {"stage"}

    def rest(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: rest(part) for key, part in value.items() if key not in costs}
        return [rest(part) for part in value] if isinstance(value, list) else value

    return rest
