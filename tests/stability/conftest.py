"""Every case of a part, in every setting that this machine offers."""

from collections.abc import Callable
from types import ModuleType

import pytest

from novags.testbed.stability import PARTS, Part, Setting, measured


def part_of(module: ModuleType) -> Part:
    """The part that a file of tests is named for."""
    return PARTS[module.__name__.rpartition("test_")[2]]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test with arguments `case` and `setting` runs once for each of the part that its file is named for."""
    if {"case", "setting"} <= set(metafunc.fixturenames):
        rows = [
            pytest.param(case, setting, id=f"{case.name}, {setting}", marks=[pytest.mark.slow] if case.slow else [])
            for case in part_of(metafunc.module).cases
            for setting in case.settings()
        ]
        metafunc.parametrize(("case", "setting"), rows)


@pytest.fixture
def fails(request: pytest.FixtureRequest) -> Callable[..., bool]:
    """A function of a case's name and a backend: whether its error is beyond its bound, as the code is now."""
    cases = {case.name: case for case in part_of(request.module).cases}

    def fails(name: str, backend: str = "torch") -> bool:
        found = measured(cases[name], Setting(backend, 1))
        # An exception counts as an infinite error: that of a stand-in which cannot even be called shows nothing.
        assert not str(found.reason).startswith(("TypeError", "AttributeError", "NameError")), found.reason
        return not found.holds

    return fails
