"""Every case of a part, in every setting that this machine offers."""

import pytest

from novags.testbed.stability import PARTS


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test with arguments `case` and `setting` runs once for each of the part that its file is named for."""
    if {"case", "setting"} <= set(metafunc.fixturenames):
        part = PARTS[metafunc.module.__name__.rpartition("test_")[2]]
        rows = [
            pytest.param(case, setting, id=f"{case.name}, {setting}", marks=[pytest.mark.slow] if case.slow else [])
            for case in part.cases
            for setting in case.settings()
        ]
        metafunc.parametrize(("case", "setting"), rows)
