"""A knob: one choice that trades accuracy for time, and how a value of it is measured."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from novags.testbed.study.cells.presets import Preset

Setting = str | int | float | None
LARGEST = 1e100  # of a time or an error: their squares must be numbers too


@dataclass(frozen=True)
class Reading:
    """One measurement of one setting.

    Attributes:
        seconds: On the wall.
        cpu_seconds: Of all processors together, user and system.
        error: In the knob's unit, >= 0; 0 is perfect.
        parts: Processor seconds by part of the work, where it has several.
    """

    seconds: float
    cpu_seconds: float
    error: float
    parts: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("seconds", "cpu_seconds", "error"):
            if not 0 <= getattr(self, name) <= LARGEST:
                raise ValueError(f"{name} must be in 0..{LARGEST:g}, got {getattr(self, name):g}")


@dataclass(frozen=True, kw_only=True)
class Knob:
    """One knob of a subject; the others are at their defaults while it is turned.

    Attributes:
        name: Unique in its subject.
        settings: The measured settings, from the fastest on.
        default: One of them.
        unit: Of the error.
        of: The unit of work of the seconds: "a view".
        why: Why the default is the default.
        measure: (setting, seed, folder of the seed's capture where the subject has some) -> one measurement. The seed
            varies what a repetition may vary.
        shared: Knobs with the same word here have one measurement of their defaults in common; None: with nobody.
        option: The option of `novags run` that the knob is, for `--budget`; None: it has none.
        parts: The parts of the work whose time a setting changes; the time of others differs by chance.
    """

    name: str
    settings: tuple[Setting, ...]
    default: Setting
    unit: str
    of: str
    why: str
    measure: Callable[[Setting, int, Path | None], Reading]
    shared: str | None = None
    option: str | None = None
    parts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.default not in self.settings or len(set(self.settings)) < len(self.settings):
            raise ValueError(f"the settings of {self.name} must be different ones and hold the default {self.default}")

    def called(self, setting: Setting) -> tuple[str, Setting]:
        """The identity under which a measurement is stored."""
        common = self.shared is not None and setting == self.default
        return (f"default of {self.shared}", None) if common else (self.name, setting)


@dataclass(frozen=True)
class Subject:
    """Knobs that are measured on the same work.

    Attributes:
        name: render, sensor, ...
        workload: The work they are measured on: scene, sizes, counts. Points of two workloads never meet in one curve.
        knobs: In the order of the page.
        modules: The modules that measure, and the modules of the rows that they use.
        pictured: The experiment whose capture a seed is measured on; None: none is needed.
    """

    name: str
    workload: Mapping[str, Any]
    knobs: tuple[Knob, ...]
    modules: tuple[str, ...] = ()
    pictured: "Callable[[int], Preset] | None" = None

    def knob(self, name: str) -> Knob:
        """The knob of a name, which is there."""
        return next(knob for knob in self.knobs if knob.name == name)


def spelled(workload: Mapping[str, Any]) -> str:
    """A workload in a sentence."""
    return ", ".join(f"{name} {value}" for name, value in workload.items())
