"""The transport plan: the table of effects, and the renderer settings that follow from it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from sensor_model.plan import Effect, Plan

INDIRECT = "indirect light"
MEDIA = "participating media"
SPECTRAL_MIS = "chromatic media"
DEEP = "paths beyond max_depth"
ROULETTE = "Russian roulette"
SPECTRAL = "spectral transport"
POLARISATION = "polarisation"
APERTURE = "depth of field"
MOTION = "motion blur"
MADE_UP = "of all light, if RGB stood for smooth spectra"  # a unit of its own: the true spectra are unknown
EFFECTS = (
    INDIRECT, DEEP, ROULETTE, MEDIA, SPECTRAL_MIS, POLARISATION, SPECTRAL, APERTURE, MOTION,
)  # in the order of the table  # fmt: skip
DIRECT_DEPTH = 2  # Mitsuba counts path vertices: 1 sees lamps only, 2 adds what they light directly

# An effect on the left that is on needs the states on the right.
NEEDS = {
    DEEP: {INDIRECT: True, ROULETTE: True},  # nothing but roulette ends an endless path
    SPECTRAL_MIS: {MEDIA: True, POLARISATION: False},  # volpathmis does not support polarisation
    POLARISATION: {SPECTRAL: True, SPECTRAL_MIS: False},  # Mitsuba polarises spectra only
}


def settle(effects: Iterable[Effect], force: dict[str, bool]) -> tuple[Effect, ...]:
    """The effects with the user's wishes, and with what follows from all that is on now."""
    settled = {
        e.name: replace(e, on=force[e.name], forced=True, reason=f"forced by name; {e.reason}")
        if e.name in force
        else e
        for e in effects
    }
    for name in sorted(NEEDS, key=lambda name: name not in force):  # wishes come before what is only planned
        if not settled[name].on:
            continue
        lacking = [needed for needed, wanted in NEEDS[name].items() if force.get(needed, wanted) != wanted]
        if lacking:
            settled[name] = replace(settled[name], on=False, reason=f"because of {lacking[0]}, forced by name")
            continue
        for needed, wanted in NEEDS[name].items():
            if settled[needed].on != wanted:
                settled[needed] = replace(settled[needed], on=wanted, reason=f"because {name} is on")
    return tuple(settled.values())


@dataclass(frozen=True, kw_only=True)
class TransportPlan(Plan):
    """Decisions on all transport effects, and the renderer settings that result.

    Attributes:
        max_depth: Longest path followed, as Mitsuba counts (2 is direct light).
        rr_depth: Path length from which Russian roulette may end a path; changes noise and time, never the mean.
        subframes: Poses that are averaged if motion blur is on.
        seconds: Processor time (on a GPU: time) of a million samples, "planned" and with "everything on"; {} if not
            measured.
        light_weights: How often each light of the scene is picked, relative; () for equally often.
    """

    max_depth: int
    rr_depth: int
    subframes: int = 1
    light_weights: tuple[float, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TransportPlan:
        """Inverse of `to_dict`, also after JSON made lists of the tuples."""
        effects = [
            {**e, **{key: math.nan for key in ("contribution", "bound") if e[key] is None}} for e in data["effects"]
        ]
        bound = math.nan if data["bound"] is None else data["bound"]  # null stands for what was not measured
        lights = tuple(data.get("light_weights", ()))
        made = super().from_dict(data | {"effects": effects, "bound": bound, "light_weights": lights})
        assert isinstance(made, cls)
        return made

    def force(self, on: Iterable[str] = (), off: Iterable[str] = ()) -> TransportPlan:
        """The same plan with some effects decided by hand, and what follows from that. The bounds are no longer known.

        Raises:
            ValueError: If an effect does not exist.
        """
        wanted = {**dict.fromkeys(on, True), **dict.fromkeys(off, False)}
        for name in wanted:
            self[name]
        return replace(self, effects=settle(self.effects, wanted), bound=math.nan, biases={})

    @property
    def color(self) -> str:
        """Colour representation, as `choose_variant` names it."""
        if self.is_on(POLARISATION):
            return "spectral_polarized"
        return "spectral" if self.is_on(SPECTRAL) else "rgb"

    def __str__(self) -> str:
        """The table, and what the plan saves."""
        if not self.seconds:
            return super().__str__()
        times = ", ".join(f"{seconds:.3g} s {name}" for name, seconds in self.seconds.items())
        saved = self.seconds["everything on"] / self.seconds["planned"]
        return f"{super().__str__()}\na million samples take {times}: {saved:.2g} times less time"

    def integrator(self) -> dict[str, Any]:
        """Mitsuba integrator of this plan."""
        kind = "path"
        if self.is_on(MEDIA):
            kind = "volpathmis" if self.is_on(SPECTRAL_MIS) else "volpath"
        depth = self.max_depth if self.is_on(INDIRECT) else DIRECT_DEPTH
        if self.is_on(DEEP) and self.is_on(INDIRECT):
            return {"type": kind, "max_depth": -1, "rr_depth": self.rr_depth}  # to Mitsuba: without end
        return {"type": kind, "max_depth": depth, "rr_depth": self.rr_depth if self.is_on(ROULETTE) else depth + 1}
