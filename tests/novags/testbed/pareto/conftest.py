"""A subject whose measurements cost nothing."""

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from novags.testbed.pareto.knob import Knob, Measured, Setting, Subject


@dataclass
class Made:
    """A subject, and the measurements that were asked of it; `stop_at`: the one at which the user presses Ctrl-C."""

    stop_at: int | None = None
    asked: list[tuple[str, Setting, int]] = field(default_factory=list)
    workload: dict[str, object] = field(default_factory=lambda: {"scene": "a wall", "size": 8})
    before: Callable[[], None] = lambda: None

    def value(self, name: str, setting: Setting, seed: int) -> Measured:
        self.before()
        if len(self.asked) == self.stop_at:
            raise KeyboardInterrupt
        self.asked.append((name, setting, seed))
        size = float(len(str(setting))) + 0.25 * seed
        return Measured(size, 2 * size, 10.0 / (size + len(name)), {"fit": size, "denoiser": 1.0})

    def knob(self, name: str, settings: tuple[Setting, ...], default: Setting, shared: str | None) -> Knob:
        return Knob(
            name=name, settings=settings, default=default, unit="codes", of="a call", why="it is",
            measure=lambda setting, seed: self.value(name, setting, seed), shared=shared, option=name,
            parts=("fit",),
        )  # fmt: skip

    @property
    def subject(self) -> Subject:
        knobs = (
            self.knob("steps", (1, 10, 100), 10, "all"), self.knob("way", ("a", "bb", None), "a", "all"),
            self.knob("lone", (1.5, 22.75), 22.75, None),
        )  # fmt: skip
        return Subject("made", self.workload, knobs)


@pytest.fixture
def made() -> Made:
    return Made()
