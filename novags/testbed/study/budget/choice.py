"""Which settings lose least in a given time.

The time of an experiment is a sum over parts (the fit, the denoiser's training, the render, and what no setting
changes). A setting multiplies some parts by measured factors and loses measured decibels; factors of several options
multiply, losses add. That they do is an assumption: curves turn one knob at a time.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

BETWEEN = 3  # settings interpolated between two measured ones


@dataclass(frozen=True)
class Option:
    """One setting of one option of `novags run`.

    Attributes:
        name: iterations, points, ...
        share: Of the preset's own value.
        factors: What it multiplies each part's seconds by; parts that are missing stay.
        lost: Expected loss against the preset's own value, dB of aligned PSNR, >= 0.
        sd: Its standard deviation.
    """

    name: str
    share: float
    factors: Mapping[str, float]
    lost: float
    sd: float


@dataclass(frozen=True)
class Choice:
    """One setting of every option.

    Attributes:
        options: One for each name.
        seconds: What the experiment takes.
        lost: Expected loss, dB.
        sd: Its standard deviation: losses of single options are taken to be independent.
    """

    options: tuple[Option, ...]
    seconds: float
    lost: float
    sd: float

    def share(self, name: str) -> float:
        """Share of the preset's own value; 1 for an option that is not there."""
        return next((option.share for option in self.options if option.name == name), 1.0)


def seconds_of(parts: Mapping[str, float], options: Sequence[Option]) -> float:
    """What an experiment takes whose parts take so long with the preset's own settings."""
    return sum(s * math.prod(option.factors.get(part, 1.0) for option in options) for part, s in parts.items())


def choice_of(parts: Mapping[str, float], options: Sequence[Option]) -> Choice:
    """The choice that these settings make."""
    lost, sd = sum(option.lost for option in options), math.hypot(*(option.sd for option in options))
    return Choice(tuple(options), seconds_of(parts, options), lost, sd)


def choose(parts: Mapping[str, float], options: Mapping[str, Sequence[Option]], limit: float) -> Choice | None:
    """The settings with the least expected loss whose time is within a limit; of equal ones the longest.

    Args:
        parts: Seconds of each part with the preset's own settings.
        options: The settings of each option; none of them: only the preset itself is there to choose.
        limit: Seconds.

    Returns:
        The choice; None if even the fastest one takes longer.
    """
    seconds, lost = _every(parts, list(options.values()))
    fitting = seconds <= limit
    if not fitting.any():
        return None
    least = lost[fitting].min()
    # losses are sums of a few numbers: equal ones may differ by rounding
    equal = fitting & (lost <= least + 1e-9)
    return _at(parts, options, int(np.argmax(np.where(equal, seconds, -np.inf))))


def fastest(parts: Mapping[str, float], options: Mapping[str, Sequence[Option]]) -> Choice:
    """The settings that take the least time."""
    seconds, _ = _every(parts, list(options.values()))
    return _at(parts, options, int(np.argmin(seconds)))


def _every(parts: Mapping[str, float], options: list[Sequence[Option]]) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and losses of all combinations, the last option changing fastest."""
    lost = np.zeros(1)
    by_part = {part: np.array([seconds], float) for part, seconds in parts.items()}
    for settings in options:
        lost = np.add.outer(lost, [s.lost for s in settings]).ravel()
        by_part = {
            part: np.multiply.outer(seconds, [s.factors.get(part, 1.0) for s in settings]).ravel()
            for part, seconds in by_part.items()
        }
    return np.sum(list(by_part.values()), axis=0) + np.zeros(len(lost)), lost


def _at(parts: Mapping[str, float], options: Mapping[str, Sequence[Option]], place: int) -> Choice:
    chosen: list[Option] = []
    for settings in reversed(list(options.values())):
        place, k = divmod(place, len(settings))
        chosen.append(settings[k])
    return choice_of(parts, chosen[::-1])


def refined(settings: Sequence[Option]) -> list[Option]:
    """Settings of one option with others interpolated between neighbours, along the logarithm of the share.

    The spread of an interpolated one is the larger of its neighbours'.
    """
    ordered = sorted(settings, key=lambda option: option.share)
    found = ordered[:1]
    for low, high in pairwise(ordered):
        for k in range(1, BETWEEN + 1):
            found.append(between(low, high, k / (BETWEEN + 1)))
        found.append(high)
    return found


def between(low: Option, high: Option, t: float) -> Option:
    """The setting a part `t` of the way from one to the other, along the logarithm of the share."""
    parts = low.factors.keys() & high.factors.keys()
    return Option(
        name=low.name, share=low.share ** (1 - t) * high.share**t,
        factors={part: low.factors[part] ** (1 - t) * high.factors[part] ** t for part in sorted(parts)},
        lost=low.lost + t * (high.lost - low.lost), sd=max(low.sd, high.sd),
    )  # fmt: skip


def united(curves: Sequence[Sequence[Option]]) -> list[Option]:
    """Curves of one option, measured with several methods, as one: for an experiment that compares these methods.

    Each method's parts keep their factors; a part that several have (the render) gets the mean. The loss is the mean of
    the methods'. Settings are those that all curves reach; between its own settings a curve is interpolated.
    """
    least = max(min(option.share for option in curve) for curve in curves)
    shares = sorted({option.share for curve in curves for option in curve if option.share >= least})
    return [_mean(share, [_at_share(curve, share) for curve in curves]) for share in shares]


def _at_share(curve: Sequence[Option], share: float) -> Option:
    low = max((option for option in curve if option.share <= share), key=lambda option: option.share)
    high = min((option for option in curve if option.share >= share), key=lambda option: option.share)
    if low.share == high.share:
        return low
    return between(low, high, math.log(share / low.share) / math.log(high.share / low.share))


def _mean(share: float, options: Sequence[Option]) -> Option:
    parts = dict.fromkeys(part for option in options for part in option.factors)
    own = {part: [option.factors[part] for option in options if part in option.factors] for part in parts}
    return Option(
        name=options[0].name, share=share, factors={part: float(np.mean(own[part])) for part in parts},
        lost=float(np.mean([option.lost for option in options])),
        sd=math.hypot(*(option.sd for option in options)) / len(options),
    )  # fmt: skip
