"""Knobs that a method declares: choices of it that trade accuracy for time, and the settings worth measuring."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Name = str | int | float | None


@dataclass(frozen=True, kw_only=True)
class MethodKnob:
    """A row of `Method.knobs`: named settings of the method's configuration, or shares of an option of the experiment.

    Attributes:
        why: Why the default is the default, for the page of curves.
        parts: The parts of the training (`Method.parts`) whose time it changes.
        settings: Name of a setting -> dotted settings of the method that it stands for, the same ones in each, from the
            fastest on. The default is the setting that agrees with the measured configuration.
        option: Or an option of the experiment. Iterations, samples per pixel and size are measured of every method with
            knobs without being declared.
        shares: Of the experiment's own value of the option, from the fastest on; 1 is the default.
    """

    why: str
    parts: tuple[str, ...] = ()
    settings: Mapping[Name, Mapping[str, Any]] = field(default_factory=dict)
    option: Literal["iterations", "points", "denoiser_steps", "spp", "size"] | None = None
    shares: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if bool(self.settings) == bool(self.shares) or (self.option is None) == bool(self.shares):
            raise ValueError("a knob has either settings, or an option of the experiment with shares of it, got "
                             f"{len(self.settings)} settings, {len(self.shares)} shares and the option {self.option}"
                             )  # fmt: skip
        if len({tuple(sorted(each)) for each in self.settings.values()}) > 1:
            every = " / ".join(", ".join(sorted(each)) for each in self.settings.values())
            raise ValueError(f"all settings of a knob must set the same names, got {every}")

    @staticmethod
    def of(setting: str, values: tuple[Name, ...], why: str, parts: tuple[str, ...]) -> "MethodKnob":
        """A knob of one setting, named after its values."""
        return MethodKnob(settings={value: {setting: value} for value in values}, why=why, parts=parts)

    def default(self, config: Mapping[str, Any]) -> Name:
        """Which of `settings` a configuration has.

        Args:
            config: `novags.settings.flattened`.

        Raises:
            ValueError: If it has none of them.
        """
        names = next(iter(self.settings.values()))
        own = {name: config.get(name) for name in names}
        for found, settings in self.settings.items():
            if dict(settings) == own:
                return found
        said = ", ".join(f"{name} = {value}" for name, value in own.items())
        raise ValueError(f"no setting of the knob agrees with the configuration ({said}): add it to the row")
