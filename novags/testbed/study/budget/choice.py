"""Which settings lose least in a given time.

The time of an experiment is a sum over parts (the fit, the denoiser's training, the render, and work that no setting
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
        factors: Factors on each part's seconds; missing parts keep theirs.
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
        seconds: The time of the experiment.
        lost: Expected loss, dB.
        sd: Its standard deviation: losses of single options are taken to be independent.
    """

    options: tuple[Option, ...]
    seconds: float
    lost: float
    sd: float


def seconds_of(parts: Mapping[str, float], options: Sequence[Option]) -> float:
    """The time of an experiment whose parts take so long with the preset's own settings."""
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
    """Settings of one option with others interpolated between neighbours, along the logarithm of the share."""
    shares = sorted(option.share for option in settings)
    steps = [k / (BETWEEN + 1) for k in range(BETWEEN + 1)]
    finer = [low ** (1 - t) * high**t for low, high in pairwise(shares) for t in steps]
    return [along(settings, share) for share in (*finer, shares[-1])]


def along(curve: Sequence[Option], share: float) -> Option:
    """A curve at a share that it reaches. The spread of an interpolated setting is the larger of its neighbours'."""
    low = max((option for option in curve if option.share <= share), key=lambda option: option.share)
    high = min((option for option in curve if option.share >= share), key=lambda option: option.share)
    t = 0.0 if low.share == high.share else math.log(share / low.share) / math.log(high.share / low.share)
    parts = sorted(low.factors.keys() & high.factors.keys())
    factors = {part: low.factors[part] ** (1 - t) * high.factors[part] ** t for part in parts}
    return Option(
        name=curve[0].name, share=share, factors=factors,
        lost=low.lost + t * (high.lost - low.lost), sd=max(low.sd, high.sd),
    )  # fmt: skip


def united(curves: Sequence[Sequence[Option]]) -> list[Option]:
    """Curves of one option, measured with several methods, as one: for an experiment that compares these methods.

    Each method's parts keep their factors; a part that several have (the render) gets the mean. The loss is the mean of
    the methods'. Settings lie in the range that all curves reach; between its own settings a curve is interpolated.
    """
    least = max(min(option.share for option in curve) for curve in curves)
    shares = sorted({option.share for curve in curves for option in curve if option.share >= least})
    found = []
    for options in ([along(curve, share) for curve in curves] for share in shares):
        parts = dict.fromkeys(part for option in options for part in option.factors)
        own = {part: [option.factors[part] for option in options if part in option.factors] for part in parts}
        found.append(Option(
            name=options[0].name, share=options[0].share, factors={p: float(np.mean(own[p])) for p in parts},
            lost=float(np.mean([option.lost for option in options])),
            sd=math.hypot(*(option.sd for option in options)) / len(options),
        ))  # fmt: skip
    return found
