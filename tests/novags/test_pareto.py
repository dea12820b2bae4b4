"""Claims about the command that measures curves: of all its subjects, and of all their measurements."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.commands import pareto
from novags.testbed.ledger import dry
from novags.testbed.report.curves import page
from novags.testbed.study import conduct, session
from novags.testbed.study.curves import study
from novags.testbed.study.knobs import subjects

Call = Callable[..., int]


def plan_of(name: str) -> Any:
    return SimpleNamespace(runs=[(SimpleNamespace(measured=SimpleNamespace(of=name, sizes="quick")),)], name=name)


def test_all_subjects_are_planned_and_their_files_named(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    named: list[str] = []
    monkeypatch.setattr(study, "plans", lambda *_, **__: [plan_of("render"), plan_of("splats")])
    monkeypatch.setattr(study, "subject_of", lambda plan: plan.name)
    monkeypatch.setattr(session, "again", lambda *_: "")
    monkeypatch.setattr(study, "told", lambda *_: [])
    monkeypatch.setattr(session, "refuse_other", lambda *_: None)
    monkeypatch.setattr(page, "written", lambda name, out: [out / f"{name}.svg"])
    monkeypatch.setattr(dry, "planned", lambda console, what, paths: named.extend(path.name for path in paths))
    assert call("pareto", "all", "--dry-run", "--out", str(tmp_path / "out")) == 0
    assert named == ["render.svg", "render", "splats.svg", "splats"]


@pytest.mark.parametrize(("states", "failed"), [(["failed", "done", "failed"], 2), (["done", "done"], 0)])
def test_measurements_that_failed_are_counted_and_the_others_drawn(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, states: list[str], failed: int
) -> None:
    drawn: list[Any] = []
    rows = [{"state": state} for state in states]
    monkeypatch.setattr(session, "describe", lambda *_: None)
    monkeypatch.setattr(conduct, "conduct", lambda *_, **__: rows)
    monkeypatch.setattr(subjects, "subject_of", lambda of, sizes: (of, sizes))
    monkeypatch.setattr(page, "write", lambda subject, found, out: drawn.append((subject, found)) or [])
    assert pareto._measured(plan_of("splats"), tmp_path, tmp_path / "store", SimpleNamespace()) == failed
    assert drawn == [(("splats", "quick"), rows)]
