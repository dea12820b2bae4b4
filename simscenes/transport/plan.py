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
UNIT = "of all light"
MADE_UP = "of all light, if RGB stood for smooth spectra"  # a unit of its own: the true spectra are unknown
EFFECTS = (
    INDIRECT, DEEP, ROULETTE, MEDIA, SPECTRAL_MIS, POLARISATION, SPECTRAL, APERTURE, MOTION,
)  # in the order of the table  # fmt: skip
POSES_PER_PIXEL = 2  # of motion blur: from one to the next the picture moves by half a pixel
DIRECT_DEPTH = 2  # Mitsuba counts path vertices: 1 sees lamps only, 2 adds surfaces they light directly

# An effect on the left that is on needs the states on the right.
NEEDS = {
    DEEP: {INDIRECT: True, ROULETTE: True},  # nothing but roulette ends an endless path
    SPECTRAL_MIS: {MEDIA: True, POLARISATION: False},  # volpathmis does not support polarisation
    POLARISATION: {SPECTRAL: True, SPECTRAL_MIS: False},  # Mitsuba polarises spectra only
}


def settle(effects: Iterable[Effect], force: dict[str, bool]) -> tuple[Effect, ...]:
    """The effects after the user's choices, and after the demands of active effects on others."""
    settled = {
        e.name: replace(e, on=force[e.name], forced=True, reason=f"forced by name; {e.reason}")
        if e.name in force
        else e
        for e in effects
    }
    for name in sorted(NEEDS, key=lambda name: name not in force):  # wishes come before plans
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
        seconds: Processor time (on a GPU: wall time) of a million samples, "planned" and with "everything on"; {} if
            not measured.
        hide_emitters: Whether cameras look through lamps, and skies are black, as a scene's own integrator may want it.
        tolerance: The share of all light that may be left out; nan if it was not asked.
        rms: The cost of leaving an effect out as an error of pixels, effect -> five numbers: the root mean square over
            the picture relative to the mean radiance, then within each quarter of it by brightness, darkest first.
        light_weights: How often each light of the scene is picked, relative; () for equally often.
    """

    max_depth: int
    rr_depth: int
    subframes: int = 1
    light_weights: tuple[float, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    hide_emitters: bool = False
    tolerance: float = math.nan
    rms: dict[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def bias(self) -> tuple[float, ...]:
        """The error of pixels by all omitted effects, at most, as the five numbers of `rms`; nan where not known."""
        if math.isnan(self.bound):
            return (math.nan,) * 5
        left = [self.rms.get(e.name) or (e.contribution,) * 5 for e in self.effects if not e.on and e.unit == UNIT]
        return tuple(float(sum(column)) for column in zip(*left, strict=True)) if left else (0.0,) * 5

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TransportPlan:
        """Inverse of `to_dict`, also after JSON made lists of the tuples."""
        effects = [
            {**e, **{key: math.nan for key in ("contribution", "bound") if e[key] is None}} for e in data["effects"]
        ]
        bound = math.nan if data["bound"] is None else data["bound"]  # null stands for a value not measured
        lights = tuple(data.get("light_weights", ()))
        tolerance = math.nan if data.get("tolerance") is None else data["tolerance"]
        rms = {name: tuple(math.inf if v is None else v for v in part) for name, part in data.get("rms", {}).items()}
        numbers = {"bound": bound, "tolerance": tolerance, "rms": rms, "light_weights": lights}
        made = super().from_dict(data | {"effects": effects} | numbers)
        assert isinstance(made, cls)
        return made

    def force(self, on: Iterable[str] = (), off: Iterable[str] = ()) -> TransportPlan:
        """The same plan with some effects decided by hand, and the consequences. The bounds are no longer known.

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
        """The table, and the time the plan saves."""
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
        hiding = {"hide_emitters": True} if self.hide_emitters else {}
        depth = self.max_depth if self.is_on(INDIRECT) else DIRECT_DEPTH
        if self.is_on(DEEP) and self.is_on(INDIRECT):
            return {"type": kind, "max_depth": -1, "rr_depth": self.rr_depth, **hiding}  # to Mitsuba: without end
        start = self.rr_depth if self.is_on(ROULETTE) else depth + 1
        return {"type": kind, "max_depth": depth, "rr_depth": start, **hiding}
