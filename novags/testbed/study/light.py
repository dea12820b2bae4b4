"""The results of a study over light: each score against the electrons, its spread over seeds, and where a method
breaks.

The knee of a curve is the light at which it has fallen by a stated amount from its own value at the most light of the
study: searched from the most light downwards, between two levels linearly in the logarithm of the electrons, for every
seed by itself. A level at which a seed has no score, because its run failed, counts as fallen; of a seed that has none
at the most light it is unknown whether and where it breaks, and so it is while its run there is still to come.
"""

import math
import statistics
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

ELECTRONS, METHOD, SEED = "electrons", "method", "seed"
OF_CAMERAS = "cameras"  # the stage that finds them


@dataclass(frozen=True)
class Measure:
    """A score that is followed over the light.

    Attributes:
        key: Short name.
        column: Of the study's table.
        label: Its name in the legend.
        unit: Its unit, "" for a pure number.
        breaks: How the knee is defined: "below" the bright value by `amount`, "above" it by the factor `amount`; None:
            it has no knee.
        amount: See `breaks`.
        missing: The value of a run that failed for want of cameras; None: it has none.
    """

    key: str
    column: str
    label: str
    unit: str = ""
    breaks: Literal["below", "above"] | None = None
    amount: float = 0.0
    missing: float | None = None

    def limit(self, bright: float) -> float:
        """The value that a curve with this bright value breaks at."""
        return bright - self.amount if self.breaks == "below" else bright * self.amount

    def beyond(self, value: float, limit: float) -> bool:
        """Whether a value is on the wrong side of a limit."""
        return value < limit if self.breaks == "below" else value > limit

    @property
    def rule(self) -> str | None:
        """The definition of the knee in words."""
        unit = f" {self.unit}" if self.unit else ""
        told = {"below": f"{self.amount:g}{unit} below", "above": f"{self.amount:g} times"}
        return None if self.breaks is None else f"{told[self.breaks]} the value at the most light"


MEASURES = (
    Measure("psnr", "enhanced.aligned_psnr", "aligned PSNR against the noise-free exposure", "dB", "below", 3.0),
    Measure("lit", "lit.tone_aligned_psnr", "tone-aligned PSNR against the well-lit truth", "dB", "below", 3.0),
    Measure("recovered", "recovered", "recovered share of what noise costs"),
    Measure("registered", "cameras.registered_share", "views that get a camera", "", "below", 0.1, missing=0.0),
    Measure("depth", "geometry.abs_rel", "relative depth error", "", "above", 2.0),
)


@dataclass(frozen=True)
class Knee:
    """Where a curve breaks.

    Attributes:
        electrons: Geometric mean over the seeds that are known; None where not every one breaks within the study.
        low: The least of the seeds that break; None if none does.
        high: The largest of these.
        seeds: How many seeds there are.
        broken: How many of them break.
        unknown: How many have no value at the most light to fall from.
    """

    electrons: float | None
    low: float | None
    high: float | None
    seeds: int
    broken: int
    unknown: int = 0


@dataclass(frozen=True)
class LevelScore:
    """A score at one light level.

    Attributes:
        electrons: The level.
        values: Of the seeds that have one.
        failed: How many runs have none because they failed.
    """

    electrons: float
    values: tuple[float, ...]
    failed: int

    @property
    def mean(self) -> float | None:
        """Over the seeds; None without any."""
        return statistics.fmean(self.values) if self.values else None

    @property
    def sd(self) -> float | None:
        """Standard deviation over the seeds; None with fewer than two."""
        return statistics.stdev(self.values) if len(self.values) > 1 else None


@dataclass(frozen=True)
class Curve:
    """One score of one method over the light.

    Attributes:
        measure: The score.
        place: The values of all other axes of the study.
        method: The method.
        levels: From the least light to the most.
        knee: Where it breaks; None for a score without that.
    """

    measure: Measure
    place: dict[str, Any]
    method: str
    levels: tuple[LevelScore, ...]
    knee: Knee | None

    @property
    def bright(self) -> float | None:
        """Its value at the most light; None where all runs of that level failed or are still to come."""
        return self.levels[-1].mean if self.levels else None

    @property
    def slope(self) -> float | None:
        """Its change per doubling of the light between the two brightest levels: far from 0 it has not settled there,
        and the knee says little. None without a value at the most light.
        """
        if self.bright is None:
            return None
        known = [(level.electrons, level.mean) for level in self.levels if level.mean is not None]
        if len(known) < 2:
            return None
        (dark, low), (bright, high) = known[-2:]
        return (high - low) / math.log2(bright / dark)


def light_curves(rows: Sequence[Mapping[str, Any]], axes: Mapping[str, Sequence[Any]]) -> list[Curve]:
    """The curves of a study.

    Args:
        rows: Of its table: axes, `state`, `stage` and scores by column.
        axes: The values of each axis; electrons must be one with at least two values.

    Raises:
        ValueError: If they do not.
    """
    if len(axes.get(ELECTRONS, ())) < 2:
        raise ValueError("curves over the light need two values or more of electrons in [grid]")
    others = [name for name in axes if name not in (ELECTRONS, METHOD, SEED)]
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in (*others, METHOD)), []).append(row)
    found = []
    for key, members in groups.items():
        place = dict(zip(others, key[:-1], strict=True))
        for measure in MEASURES:
            curve = _curve(measure, place, str(key[-1]), members)
            if any(level.values for level in curve.levels):
                found.append(curve)
    return found


def _curve(measure: Measure, place: dict[str, Any], method: str, rows: Iterable[Mapping[str, Any]]) -> Curve:
    seeds: dict[Any, dict[float, float | None]] = {}
    failed = Counter[float]()
    for row in rows:
        electrons, value = float(row[ELECTRONS]), _value(row, measure)
        if row["state"] in ("done", "failed", "skipped"):
            seeds.setdefault(row.get(SEED), {})[electrons] = value
            failed[electrons] += row["state"] != "done" and value is None  # a finished run may lack a score
        else:
            failed[electrons] += 0  # a level of the study all the same: none with less light is the brightest
    levels = []
    for electrons in sorted(failed):
        each = [seed[electrons] for seed in seeds.values() if electrons in seed]
        values = tuple(value for value in each if value is not None)
        levels.append(LevelScore(electrons, values, failed[electrons]))
    knee = None if measure.breaks is None else _knee(seeds.values(), max(failed, default=0.0), measure)
    return Curve(measure, place, method, tuple(levels), knee)


def _knee(seeds: Collection[Mapping[float, float | None]], most: float, measure: Measure) -> Knee:
    """The knee of all seeds; seeds without a value at the most light are unknown."""
    known = [seed for seed in seeds if seed.get(most) is not None]
    return common_knee([knee_of(seed, measure) for seed in known], unknown=len(seeds) - len(known))


def _value(row: Mapping[str, Any], measure: Measure) -> float | None:
    if row["state"] == "failed" and row.get("stage") == OF_CAMERAS:
        return measure.missing
    value = row.get(measure.column) if row["state"] == "done" else None
    number = math.nan if value is None else float(value)
    return number if math.isfinite(number) else None  # JSON has infinity as text; no curve leads there


def knee_of(values: Mapping[float, float | None], measure: Measure) -> float | None:
    """The light at which one seed's curve breaks; None if it does not.

    Args:
        values: Score by electrons; None where the run failed.
        measure: Its rule.
    """
    levels = sorted(values, reverse=True)
    bright = values[levels[0]] if levels else None
    if bright is None:
        return None  # there is nothing to fall from
    limit = measure.limit(bright)
    above, last = levels[0], bright
    for level in levels[1:]:
        value = values[level]
        if value is None:
            return above  # it breaks somewhere between the two; this much light is enough
        if measure.beyond(value, limit):
            share = (last - limit) / (last - value)
            return float(math.exp(math.log(above) + share * math.log(level / above)))
        above, last = level, value
    return None


def common_knee(knees: Sequence[float | None], unknown: int = 0) -> Knee:
    """The knees of all seeds as one, beside `unknown` further seeds."""
    known = [knee for knee in knees if knee is not None]
    mean = statistics.geometric_mean(known) if known and len(known) == len(knees) else None
    return Knee(mean, min(known, default=None), max(known, default=None), len(knees) + unknown, len(known),
                unknown)  # fmt: skip
