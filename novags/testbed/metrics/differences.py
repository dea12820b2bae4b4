"""Differences between methods with their standard errors, the shares made of them, and places that know both.

Every score is of a scene, a seed and a view. Two methods saw the same noise and the same views: they are compared value
by value, so that what they have in common cancels. The scatter of these differences is what the mean may be wrong by:

- Of several scenes: each has one mean difference D, and the error is sd(D) / sqrt(scenes), of scenes - 1 degrees of
  freedom. What seeds and views scatter is in it.
- Of one scene, this scene is all that is spoken of. Of one seed the views count, of one view the seeds. Of several of
  both, with effects of views, of seeds and of both together at random: (MS_views + MS_seeds - MS_both) / (views seeds),
  of Satterthwaite's degrees of freedom, and no less than either mean square alone would give.

Intervals are t intervals of 95 %. A difference is seen if its interval leaves 0 out.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, sqrt
from statistics import fmean
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

LEVEL = 0.95  # of intervals
ERRORS = 3.0  # standard errors that the span of a share must have at least
POWER = 0.8  # of studies see the difference that `smallest_seen` names

Values: TypeAlias = Mapping[tuple[str, str, str], float]
"""Scores by scene, seed and view."""


@dataclass(frozen=True)
class Estimate:
    """A mean over scenes, seeds and views.

    Attributes:
        value: In the unit of the values.
        error: Its standard error; None where nothing repeats.
        freedom: Degrees of freedom of the error.
        over: The repeats behind the error: "scenes", or of one scene "views", "seeds" or "views and seeds"; "" without
            error.
        scenes: How many.
        seeds: Of a scene, at most.
        views: Of a scene, at most.
    """

    value: float
    error: float | None
    freedom: float
    over: str
    scenes: int
    seeds: int
    views: int

    @property
    def half(self) -> float | None:
        """Half of its interval: t times the standard error."""
        return None if self.error is None else quantile(self.freedom) * self.error

    @property
    def seen(self) -> bool:
        """Whether it is seen not to be 0."""
        return self.half is not None and abs(self.value) > self.half

    @property
    def where(self) -> str:
        """The scenes that it speaks of, and the views and seeds that its error is over."""
        if self.over == "scenes":
            return f"{self.scenes} scenes"
        counts = {"views": self.views, "seeds": self.seeds}
        listed = " and ".join(f"{counts[what]} {what}" for what in self.over.split(" and ")) if self.over else ""
        return f"this scene, {listed}" if listed else "this scene, one view and one seed: no error is known"


def quantile(freedom: float, level: float = LEVEL) -> float:
    """The t quantile of a two-sided interval."""
    from scipy.stats import t

    return float(t.ppf((1 + level) / 2, freedom))


def estimate(values: Values) -> Estimate | None:
    """The mean of values and its standard error, see the module; None without values.

    Of a scene only views count that all its seeds have.
    """
    tables = [table for scene in dict.fromkeys(key[0] for key in values) if (table := _table(values, scene)).size]
    if not tables:
        return None
    scenes, seeds, views = len(tables), max(len(t) for t in tables), max(t.shape[1] for t in tables)
    means = np.array([table.mean() for table in tables])
    if scenes > 1:
        error, freedom, over = float(means.std(ddof=1)) / sqrt(scenes), scenes - 1.0, "scenes"
        return Estimate(float(means.mean()), error, freedom, over, scenes, seeds, views)
    return Estimate(float(means[0]), *_of_scene(tables[0]), scenes, seeds, views)


def _table(values: Values, scene: str) -> NDArray[np.float64]:
    """The finite values of a scene, [seeds, views]."""
    found: dict[str, dict[str, float]] = {}
    for (name, seed, view), value in values.items():
        if name == scene and isfinite(value):
            found.setdefault(seed, {})[view] = value
    views = [view for view in next(iter(found.values()), {}) if all(view in own for own in found.values())]
    return np.array([[own[view] for view in views] for own in found.values()]).reshape(len(found), len(views))


def _of_scene(table: NDArray[np.float64]) -> tuple[float | None, float, str]:
    """Standard error of the mean of [seeds, views], its degrees of freedom, and what it is over."""
    seeds, views = table.shape
    if seeds == 1 or views == 1:
        if table.size < 2:
            return None, 0.0, ""
        return float(table.std(ddof=1)) / sqrt(table.size), table.size - 1.0, "views" if seeds == 1 else "seeds"
    of_views, of_seeds = table.mean(0), table.mean(1)
    rest = table - of_views - of_seeds[:, None] + table.mean()
    squares = np.array([seeds * of_views.var(ddof=1), views * of_seeds.var(ddof=1),
                        (rest**2).sum() / ((seeds - 1) * (views - 1))])  # fmt: skip
    each = np.array([views - 1, seeds - 1, (seeds - 1) * (views - 1)])
    total, most = squares @ [1, 1, -1], int(squares[:2].argmax())
    if total >= squares[most] > 0:
        freedom = float(total**2 / (squares**2 / each).sum())
        return sqrt(total / table.size), freedom, "views and seeds"
    return sqrt(squares[most] / table.size), float(each[most]), "views and seeds"


def paired(one: Values, other: Values) -> Values:
    """One less the other, where both have a value."""
    return {key: value - other[key] for key, value in one.items() if key in other}


def difference(one: Values, other: Values) -> Estimate | None:
    """How far `one` is above `other`; None where they have no value in common."""
    return estimate(paired(one, other))


def share(one: Values, floor: Values, ceiling: Values, least: float = 0.0) -> Estimate | None:
    """(one - floor) / (ceiling - floor), by means over common values, with the ratio's error (delta method).

    None where the span is below `ERRORS` of its standard errors, is not seen, or is not above `least`: a ratio of two
    scatters says nothing.
    """
    span = {key: value for key, value in paired(ceiling, floor).items() if key in one and isfinite(one[key])}
    gain = {key: one[key] - floor[key] for key in span}
    known, won = estimate(span), estimate(gain)
    if known is None or won is None or not is_span(known, least):
        return None
    ratio = won.value / known.value
    rest = estimate({key: value - ratio * span[key] for key, value in gain.items()})
    if rest is None or rest.error is None:
        return None
    return Estimate(ratio, rest.error / known.value, rest.freedom, rest.over, rest.scenes, rest.seeds, rest.views)


def is_span(span: Estimate, least: float = 0.0) -> bool:
    """Whether shares of a span say anything."""
    return span.error is not None and span.seen and span.value >= ERRORS * span.error and span.value > least


def places(values: Mapping[str, Values], more: bool, digits: int) -> dict[str, int]:
    """The place of each: 1 and how many are seen to be better; those that are not seen to differ share it.

    Two methods are compared by the values that both have. Means that are printed alike differ by nothing. Where nothing
    repeats, as in counts and costs, the one pair of values decides.

    Args:
        values: The scores of each.
        more: Whether more is better.
        digits: After the point, as they are printed.
    """
    means = {name: _mean(own) for name, own in values.items() if own}

    def is_better(one: str, other: str) -> bool:
        alike = round(means[one], digits) == round(means[other], digits)
        found = None if alike else _lead(values[one], values[other], more)
        return found is not None and found[0] > 0 and found[1]

    return {name: 1 + sum(is_better(other, name) for other in means) for name in means}


def order(values: Mapping[str, Values], more: bool) -> list[str]:
    """Names, best first: by the number of others that a method beats on the values that both have, then by its mean.

    Where all methods have the same scenes, seeds and views, this is the order of the means.
    """
    means = {name: _mean(own) * (1 if more else -1) for name, own in values.items() if own}
    ahead = {name: sum((found := _lead(values[name], values[other], more)) is not None and found[0] > 0
                       for other in means) for name in means}  # fmt: skip
    return sorted(means, key=lambda name: (-ahead[name], -means[name]))


def _mean(values: Values) -> float:
    """The mean that tables print; infinite if a score is infinite."""
    found = estimate(values) if all(map(isfinite, values.values())) else None
    return fmean(values.values()) if found is None else found.value


def _lead(one: Values, other: Values, more: bool) -> tuple[float, bool] | None:
    """How much better `one` is, and whether that is seen; None where both have no value in common."""
    common = paired(one, other)
    if not common:
        return None
    sign, apart = 1 if more else -1, estimate(common)
    if apart is None:  # a score is infinite wherever both have one
        a, b = (fmean(own[key] for key in common) for own in (one, other))
        return (0.0 if a == b else sign * (a - b)), True
    return sign * apart.value, apart.error is None or apart.seen


def smallest_seen(scenes: int, seeds: int, views: int, scatter: "Scatter") -> float | None:
    """The difference that a study of so many sees with the probability `POWER`; None where nothing repeats.

    The standard error that the scatter gives, times the shift at which Student's t passes the end of the interval so
    often (noncentral t).
    """
    within = scatter.seeds**2 / seeds + scatter.views**2 / (seeds * views)
    if scenes > 1:
        variance, freedom = (scatter.scenes**2 + within) / scenes, scenes - 1
    elif views > 1 or seeds > 1:
        variance, freedom = within, (seeds if views == 1 else views) - 1
    else:
        return None
    return shift_seen(freedom) * sqrt(variance)


def shift_seen(freedom: float) -> float:
    """The true difference, in standard errors, that is seen with the probability `POWER`."""
    from scipy.optimize import brentq
    from scipy.stats import nct

    end = quantile(freedom)
    return float(brentq(lambda shift: nct.sf(end, freedom, shift) - POWER, 0.0, 4 * end))


@dataclass(frozen=True)
class Scatter:
    """Standard deviations of paired differences, in the unit of the score.

    Attributes:
        scenes: Of the true difference from scene to scene.
        seeds: From seed to seed of a scene.
        views: From view to view, and of both together.
    """

    scenes: float
    seeds: float
    views: float
