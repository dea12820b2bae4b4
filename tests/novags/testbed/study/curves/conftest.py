"""A subject whose measurements cost nothing, and a study of it done in this process."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.study.conduct import conduct
from novags.testbed.study.curves import study
from novags.testbed.study.curves.curve import curves
from novags.testbed.study.engines.here import Here
from novags.testbed.study.knobs import subjects
from novags.testbed.study.knobs.knob import Knob, Reading, Setting, Subject
from novags.testbed.study.plan import StudyPlan
from novags.testbed.study.session import describe

QUIET = Console(quiet=True)
FILE = '[measure]\nsubject = "made"\n[override]\nsize = 8\n[grid]\nseed = [0]\n[quick.override]\nsize = 4\n'


@dataclass
class Made:
    """A subject, and the measurements that were asked of it; `stop_at`: the one at which the user presses Ctrl-C."""

    folder: Path
    stop_at: int | None = None
    asked: list[tuple[str, Setting, int]] = field(default_factory=list)
    modules: tuple[str, ...] = ("novags.testbed.study.cells.levels",)
    fails: tuple[str, Setting] | None = None
    before: Callable[[], None] = lambda: None

    def value(self, name: str, setting: Setting, seed: int) -> Reading:
        self.before()
        if len(self.asked) == self.stop_at:
            raise KeyboardInterrupt
        if (name, setting) == self.fails:
            raise ValueError("it does not go")
        self.asked.append((name, setting, seed))
        size = float(len(str(setting))) + 0.25 * seed
        return Reading(size, 2 * size, 10.0 / (size + len(name)), {"fit": size, "denoiser": 1.0})

    def knob(self, name: str, settings: tuple[Setting, ...], default: Setting, shared: str | None) -> Knob:
        return Knob(
            name=name, settings=settings, default=default, unit="codes", of="a call", why="it is",
            measure=lambda setting, seed, captured: self.value(name, setting, seed), shared=shared, option=name,
            parts=("fit",),
        )  # fmt: skip

    def subject(self, size: int) -> Subject:
        knobs = (
            self.knob("steps", (1, 10, 100), 10, "all"), self.knob("way", ("a", "bb", None), "a", "all"),
            self.knob("lone", (1.5, 22.75), 22.75, None),
        )  # fmt: skip
        return Subject("made", {"scene": "a wall", "size": size}, knobs, self.modules)

    @property
    def store(self) -> Path:
        return self.folder / "store"

    def plan(self, **more: Any) -> StudyPlan:
        subjects.subject_of.cache_clear()
        (plan,) = study.plans("made", self.store, QUIET, **more)
        return plan

    def measure(self, out: str = "made", **more: Any) -> list[dict[str, Any]]:
        """The rows of the study of a subject."""
        plan, folder = self.plan(**more), self.folder / out
        describe(plan, folder, self.store)
        return conduct(plan, folder, self.store, QUIET, Here(QUIET), retry_failed=True)

    def curves(self, repeats: int) -> list[dict[str, Any]]:
        """Its curves, from so many repetitions."""
        return curves(self.subject(8), self.measure(repeats=repeats))

    @staticmethod
    def row(name: str, setting: Setting, seed: int, measured: Reading) -> dict[str, Any]:
        """A row of a table, as if it had been measured."""
        of_parts = {f"parts.{part}": value for part, value in measured.parts.items()}
        return {"state": "done", "knob": name, "setting": setting, "seed": seed, "seconds": measured.seconds,
                "cpu_seconds": measured.cpu_seconds, "error": measured.error, **of_parts}  # fmt: skip


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Made]:
    found = Made(tmp_path / "made")
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "made.toml").write_text(FILE)
    monkeypatch.setitem(subjects.PARTS, "made", found.subject)
    monkeypatch.setattr(study, "STUDIES", tmp_path / "studies")
    subjects.subject_of.cache_clear()
    yield found
    subjects.subject_of.cache_clear()
