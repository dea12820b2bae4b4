"""The effects a simulation includes, the effects it leaves out, and the bound on the error of leaving them out.

Both planners (light transport and sensor) return this table; it prints, and is saved with every result.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from sensor_model.params import require


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One effect, and the decision on it."""

    name: str
    on: bool  # is it simulated?
    forced: bool  # did the user decide, not the planner?
    contribution: float  # error of leaving it out, estimated or bounded, in `unit`
    bound: float  # the most that may be left out, in `unit`
    unit: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The decisions on all effects, and the bound on the error of all omitted ones together."""

    effects: tuple[Effect, ...]
    bound: float  # on the total error, in `unit`
    unit: str
    biases: dict[str, float] = field(default_factory=dict)  # further bounds, unit -> value

    def __getitem__(self, name: str) -> Effect:
        """The effect of that name. Raises ValueError, listing the known names, if it is not one of them."""
        found = [effect for effect in self.effects if effect.name == name]
        require(bool(found), "effect name", f"one of {self.names}", name)
        return found[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all effects, in the order of the table."""
        return tuple(effect.name for effect in self.effects)

    def is_on(self, name: str) -> bool:
        """Is this effect simulated?"""
        return self[name].on

    def force(self, on: Iterable[str] = (), off: Iterable[str] = ()) -> Plan:
        """The same plan with some effects decided by hand. The total bound no longer holds for those forced off."""
        wanted = {**dict.fromkeys(on, True), **dict.fromkeys(off, False)}
        for name in wanted:
            self[name]
        effects = tuple(
            replace(e, on=wanted[e.name], forced=True, reason="forced by name") if e.name in wanted else e
            for e in self.effects
        )
        return replace(self, effects=effects)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Plan:
        """Inverse of `to_dict`."""
        return cls(**(data | {"effects": tuple(Effect(**e) for e in data["effects"])}))

    def __str__(self) -> str:
        """A table."""
        marks = dict[str, str]()
        rows = [("effect", "", "left out costs", "allowed", "unit", "reason")]
        for e in self.effects:
            over = not e.on and e.contribution > e.bound
            state = ("on" if e.on else "off") + "*" * e.forced + "!" * over
            marks |= {"*": "forced by name"} if e.forced else {}
            marks |= {"!": "left out above its allowance"} if over else {}
            rows.append((e.name, state, f"{e.contribution:.3g}", f"{e.bound:.3g}", e.unit, e.reason))
        widths = [max(len(row[i]) for row in rows) for i in range(5)]
        lines = ["  ".join([*(c.ljust(n) for c, n in zip(row, widths, strict=False)), row[5]]) for row in rows]
        total = [f"{self.bound:.3g} {self.unit}", *(f"{value:.3g} {unit}" for unit, value in self.biases.items())]
        legend = "; ".join(f"{mark} {meaning}" for mark, meaning in marks.items())
        last = f"all that is left out: at most {', '.join(total)}"
        return "\n".join([*lines, f"{last}   ({legend})" if legend else last])
