"""Which tests reach which functions, and how long they take: one run of the tests on the unchanged sources.

The recorder is a pytest plugin; so is the choice of tests that a mutant is judged by.
"""

import json
import os
import signal
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from .mutants import Mutant


class Recorder:
    """Writes, at the end of a session, the seconds of each test and the functions of the watched files that it ran.

    Functions that a fixture runs count for all tests of the file: the fixture may be shared among them.
    """

    def __init__(self, watched: dict[str, str], path: Path, longest: float) -> None:
        """Record a session.

        Args:
            watched: The name that a source is written down by, by its absolute path.
            path: Where the findings go.
            longest: Seconds of computing after which a test is stopped and left out; its fixtures have thrice that.
        """
        self.watched, self.path, self.longest = watched, path, longest
        self.seconds: dict[str, float] = defaultdict(float)
        self.lines: dict[str, dict[str, set[int]]] = defaultdict(lambda: defaultdict(set))
        self.now: dict[str, set[int]] = {}
        self.entered = set[int]()
        self.failed = set[str]()

    def _call(self, frame: Any, event: str, arg: object) -> None:
        """Of a function that is entered all lines count: to watch each of them would take several times as long."""
        name = self.watched.get(frame.f_code.co_filename)
        if name is not None and id(frame.f_code) not in self.entered:
            self.entered.add(id(frame.f_code))
            self.now.setdefault(name, set()).update(line for *_, line in frame.f_code.co_lines() if line)

    def _traced(self, item: pytest.Item, who: str, longest: float) -> Iterator[None]:
        started, self.now = _computed(), {}
        self.entered.clear()
        threading.settrace(self._call)
        sys.settrace(self._call)
        signal.signal(signal.SIGPROF, _stop)
        signal.setitimer(signal.ITIMER_PROF, longest)
        yield
        signal.setitimer(signal.ITIMER_PROF, 0)
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]
        self.seconds[item.nodeid] += _computed() - started
        for name, lines in self.now.items():
            self.lines[name][who] |= lines

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        """Fixtures."""
        yield from self._traced(item, item.nodeid.split("::")[0], 3 * self.longest)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """The test itself."""
        yield from self._traced(item, item.nodeid, self.longest)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Leave out a test that fails already."""
        if report.failed:
            self.failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        """Write the findings."""
        seconds = {test: spent for test, spent in self.seconds.items() if test not in self.failed}
        lines = {name: {who: sorted(seen) for who, seen in by.items()} for name, by in self.lines.items()}
        self.path.write_text(json.dumps({"seconds": seconds, "lines": lines}), encoding="utf-8")


def _computed() -> float:
    """Seconds that this process and its children have computed: a busy machine makes them no more."""
    return sum(os.times()[:4])


def _stop(signum: int, frame: object) -> None:
    pytest.fail("it takes too long to be asked")


class Chosen:
    """Only these tests, in this order; the first that fails is written down."""

    def __init__(self, tests: tuple[str, ...], failed: Path) -> None:
        self.rank, self.failed = {test: i for i, test in enumerate(tests)}, failed

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Drop the others."""
        items[:] = sorted((i for i in items if i.nodeid in self.rank), key=lambda i: self.rank[i.nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a failure of setup, test or teardown."""
        if report.failed:
            self.failed.write_text(report.nodeid, encoding="utf-8")


def tests_reaching(known: dict[str, Any], file: str, mutant: Mutant, *, everywhere: bool) -> list[str]:
    """Tests that enter its function, quickest first; all of them if the expression is evaluated on import.

    Args:
        known: What tests enter, and their seconds.
        file: Of the mutant.
        mutant: The mutant.
        everywhere: Whether all tests count, because it cannot be seen which of them enter.
    """
    seconds: dict[str, float] = known["seconds"]
    if mutant.imported or everywhere:
        return sorted(seconds, key=seconds.__getitem__)
    wanted = range(mutant.lines[0], mutant.lines[1] + 1)
    reaching = {who for who, lines in known["lines"].get(file, {}).items() if not set(wanted).isdisjoint(lines)}
    found = [test for test in seconds if test in reaching or test.split("::")[0] in reaching]
    return sorted(found, key=seconds.__getitem__)
