"""Every hard case of a file's `PART`, in every setting that this machine offers, and the table of their errors."""

import csv
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from tests.stability.case import Case, Error, Fails, Part, Setting

HEAD = ["part", "case", "worst error", "bound", "unit", "computed by"]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--hard-cases", type=Path, metavar="CSV", help="table that takes the errors of the hard cases")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test with arguments `case` and `setting` runs once for each of its file's part."""
    if {"case", "setting"} <= set(metafunc.fixturenames):
        rows = [
            pytest.param(case, setting, id=f"{case.name}, {setting}", marks=[pytest.mark.slow] if case.slow else [])
            for case in metafunc.module.PART.cases
            for setting in case.settings()
        ]
        metafunc.parametrize(("case", "setting"), rows)


@pytest.fixture
def error(record_property: Callable[[str, object], None]) -> Error:
    """A function: the error of a case in a setting, which goes on record for the table."""

    def error(case: Case, setting: Setting) -> float:
        found = case.error(setting)
        record_property("hard case", (case.part, case.name, case.bound, case.unit, setting.backend, found))
        return found

    return error


@pytest.fixture
def fails(request: pytest.FixtureRequest) -> Fails:
    """A function of (the start of) a case's name and a backend: whether it exceeds its bound, as the code is now."""
    part: Part = request.module.PART

    def fails(name: str, backend: str | None = None) -> bool:
        case = part.named(name)
        try:
            return not case.error(Setting(backend or case.backends[0])) <= case.bound  # NaN fails
        except (TypeError, AttributeError, NameError):
            raise  # a stand-in that cannot even be called shows nothing
        except Exception:
            return True

    return fails


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, exitstatus: int, config: pytest.Config) -> None:
    path = config.getoption("hard_cases", None)
    if path is None:
        return
    if exitstatus:
        terminalreporter.write_line(f"{path} stays as it is: its numbers are those of a run that passes")
        return
    passed = terminalreporter.stats["passed"]
    found = [value for report in passed for name, value in report.user_properties if name == "hard case"]
    known: dict[str, list[list[str]]] = {}
    for row in list(csv.reader(path.read_text(encoding="utf-8").splitlines()))[1:]:
        known.setdefault(row[0], []).append(row)
    parts = known | tables(found)  # parts that were not run keep their rows
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEAD, *(row for rows in parts.values() for row in rows)])


def tables(rows: Iterable[tuple[str, str, float, str, str, float]]) -> dict[str, list[list[str]]]:
    """The rows of each part: a row a case with the worst error of all its settings."""
    parts: dict[str, dict[tuple[str, float, str], list[tuple[str, float]]]] = {}
    for part, name, bound, unit, backend, found in rows:
        parts.setdefault(part, {}).setdefault((name, bound, unit), []).append((backend, found))
    made: dict[str, list[list[str]]] = {}
    for part, cases in parts.items():
        for (name, bound, unit), errors in cases.items():
            worst = max(found for _, found in errors)
            backends = ", ".join(dict.fromkeys(backend for backend, _ in errors))
            made.setdefault(part, []).append([part, name, f"{worst:.2g}", f"{bound:.2g}", unit, backends])
    return made
