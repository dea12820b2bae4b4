import math

import pytest

from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.methods import long_runs
from novags.testbed.stability.parts.methods.long_runs import PART

CASES = {case.name: case for case in PART.cases}
HERE = Setting("numba", 1)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_a_short_run_holds_and_one_that_drifts_or_lacks_its_norms_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long_runs, "ITERATIONS", 20)
    case = CASES["20,000 iterations at two electrons: naive"]
    assert measured(case, HERE).holds
    monkeypatch.setitem(long_runs.LARGEST, "log_scales", 0.1)
    assert not measured(case, HERE).holds
    monkeypatch.setitem(long_runs.LARGEST, "log_scales", math.inf)
    monkeypatch.setitem(long_runs.LARGEST, "an unknown group", 1.0)
    assert measured(case, HERE).error == math.inf
