"""Does a simulation predict reality? The same methods in a simulated study and in a real one, and the noise of both.

Scenes of the two sides need not be the same, so nothing is paired across them: each difference of two methods is paired
within its side, and the two differences are compared by their errors. Noise is estimated from the pictures of both
sides by one estimator, so that what it takes for noise is the same.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import torch

from novags.methods import METHODS
from novags.methods.noise_estimate import noise_from
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.run import open_run
from novags.testbed.folders.runs import ROWS, TABLE
from novags.testbed.ledger.contents import read_json
from novags.testbed.metrics.differences import Estimate, Values, difference, estimate, quantile
from novags.testbed.stages.scores.comparing import values_of
from novags.testbed.study.differences import SCENE
from novags.testbed.study.light import METHOD, SEED
from sensor_model.files.reading import meant, some

SCORES = (("lit", "tone_aligned_psnr"), ("lit", "psnr"), ("lit", "ssim"), ("geometry", "abs_rel"))
FEWEST = 3  # methods that have an order to speak of
EXACT = 8  # methods up to which all orders are counted: 40,320
LEVELS = (0.1, 0.5, 0.9)  # quantiles of the real light at which the noise is compared
# Standard deviation of the estimate's logarithm between sets of pictures of one camera, which all views of a set share:
# the ratio of two sets of `test_twins.pictures` scattered by 5 % at the brightest level, over four pairs of seeds.
BETWEEN_SETS = 0.04


@dataclass(frozen=True)
class StudySide:
    """The finished runs of one study.

    Attributes:
        path: Its folder.
        rows: As in results.json, of one value of every axis but method, scene and seed.
        axes: Their names.
    """

    path: Path
    rows: Sequence[Mapping[str, Any]]
    axes: tuple[str, ...]

    @staticmethod
    def of(path: Path, where: Mapping[str, str]) -> "StudySide":
        """The runs of a study's folder that have these values.

        Raises:
            ValueError: If there is no table, nothing is left, or a further axis still has several values.
        """
        if not (path / TABLE).is_file():
            raise ValueError(f"{path} holds no {TABLE}: it is no folder of a study (novags study, novags run)")
        table = read_json(path / TABLE, ROWS)
        asked = {name: value for name, value in where.items() if name in table["axes"]}
        rows = [row for row in table["rows"] if row["state"] == "done"
                and all(str(row.get(name)) == value for name, value in asked.items())]  # fmt: skip
        if not rows:
            raise ValueError(f"{path} has no finished run{' with ' * bool(asked)}{_spelt(asked)}")
        for name in (name for name in table["axes"] if name not in (METHOD, SEED, SCENE)):
            values = list(dict.fromkeys(str(row.get(name)) for row in rows))
            if len(values) > 1:
                raise ValueError(f"{path} has runs of several {name} ({some(values, 6)}), and one is to be compared: "
                                 f"add --where {name}={values[0]}")  # fmt: skip
        return StudySide(path, rows, tuple(table["axes"]))

    @cached_property
    def scores(self) -> list[dict[str, Any]]:
        """All scores of each row."""
        found = [open_run(self.path / row["folder"]).scores() for row in self.rows]
        return [own or {} for own in found]

    @property
    def methods(self) -> list[str]:
        """Their names, in the order of the table."""
        return list(dict.fromkeys(str(row[METHOD]) for row in self.rows))

    def values(self, method: str, kind: str, number: str) -> Values:
        """A score of a method by scene, seed and held-out view."""
        found: dict[tuple[str, str, str], float] = {}
        for row, scores in zip(self.rows, self.scores, strict=True):
            if row[METHOD] == method:
                found |= values_of(scores, kind, number, str(row.get(SCENE, "")), str(row.get(SEED, "")))
        return found

    def pictures(self) -> "list[Pictures]":
        """The training pictures of all captures that the runs were made of.

        Raises:
            ValueError: If one of them is not there.
        """
        found: dict[Path, Capture] = {}
        for row in self.rows:
            capture = open_run(self.path / row["folder"]).capture()
            found.setdefault(capture.path, capture)
        return [each for capture in found.values() for each in pictures_of(capture)]


def both_sides(twin: Path, real: Path, where: Mapping[str, str]) -> tuple[StudySide, StudySide]:
    """Both sides, with these values of the axes that they have.

    Raises:
        ValueError: As `StudySide.of`, and if no side has such an axis.
    """
    sides = StudySide.of(twin, where), StudySide.of(real, where)
    axes = tuple(dict.fromkeys(name for side in sides for name in side.axes))
    if unknown := next((name for name in where if name not in axes), None):
        raise ValueError(f"--where {unknown}: neither study has such an axis; {meant(unknown, axes)}there are "
                         f"{', '.join(axes)}")  # fmt: skip
    return sides


def floor_of(methods: Sequence[str]) -> str:
    """The floor of the scale among some methods, else the first."""
    rows = (name for name in methods if name in METHODS and METHODS[name].bound == "floor")
    return next(rows, methods[0])


def _spelt(where: Mapping[str, str]) -> str:
    return ", ".join(f"{name}={value}" for name, value in where.items())


@dataclass(frozen=True)
class RankCorrelation:
    """Spearman's coefficient of the mean scores of methods.

    Attributes:
        value: 1: the same order, -1: the reverse.
        p: Share of all orders that agree at least as well; of more than `EXACT` methods by Student's approximation.
        methods: How many.
    """

    value: float
    p: float
    methods: int


def rank_correlation(one: Sequence[float], other: Sequence[float]) -> RankCorrelation:
    """Of two lists of numbers of the same things; ties share a rank."""
    from scipy.stats import rankdata, spearmanr

    a, b = (rankdata(values) - (len(values) + 1) / 2 for values in (one, other))
    scale = math.sqrt(float(a @ a) * float(b @ b))
    found = float(a @ b) / scale if scale > 0 else 0.0  # all alike have no order
    if scale == 0:
        return RankCorrelation(found, 1.0, len(a))
    if len(a) > EXACT:
        return RankCorrelation(found, float(spearmanr(one, other, alternative="greater").pvalue), len(a))
    orders = np.array(list(permutations(b)))
    return RankCorrelation(found, float(((orders @ a) / scale >= found - 1e-9).mean()), len(a))


@dataclass(frozen=True)
class Predicted:
    """A method's difference to another, in the twin and in reality."""

    method: str
    twin: Estimate
    real: Estimate

    @property
    def agrees(self) -> bool | None:
        """Whether the two differences are within their common interval; None where an error is not known."""
        if self.twin.error is None or self.real.error is None:
            return None
        squares = self.twin.error**2, self.real.error**2
        if not sum(squares):
            return self.twin.value == self.real.value
        freedom = sum(squares) ** 2 / (squares[0] ** 2 / self.twin.freedom + squares[1] ** 2 / self.real.freedom)
        return abs(self.twin.value - self.real.value) <= quantile(freedom) * math.sqrt(sum(squares))


@dataclass(frozen=True)
class NoiseRatio:
    """Noise of the twin over noise of reality at one level of light.

    Attributes:
        level: Light, 1 = white.
        value: Ratio of the standard deviations in green.
        error: Standard error, by the scatter over views and `BETWEEN_SETS`.
        freedom: Of the error.
    """

    level: float
    value: float
    error: float
    freedom: float

    @property
    def seen(self) -> bool:
        """Whether it is seen not to be 1."""
        return abs(math.log(self.value)) > quantile(self.freedom) * self.error / self.value


@dataclass(frozen=True)
class TwinVerdict:
    """What a simulated study predicts of a real one."""

    twin: StudySide
    real: StudySide
    against: str
    noise: Sequence[NoiseRatio]

    @cached_property
    def methods(self) -> list[str]:
        """Those of both sides.

        Raises:
            ValueError: If there are too few, or `against` is none of them.
        """
        found = [name for name in self.twin.methods if name in self.real.methods]
        if len(found) < FEWEST:
            raise ValueError(f"{FEWEST} methods or more must be in both studies, got {len(found)} ({some(found, 6)}): "
                             f"{self.twin.path} has {some(self.twin.methods, 6)}")  # fmt: skip
        if self.against not in found:
            raise ValueError(f"--against must be a method of both studies ({some(found, 8)}), got {self.against!r}")
        return found

    def known(self, kind: str, number: str) -> list[str]:
        """The methods that have a score on both sides."""
        return [name for name in self.methods
                if all(side.values(name, kind, number) for side in (self.twin, self.real))]  # fmt: skip

    def order(self, kind: str, number: str) -> RankCorrelation | None:
        """How well the order by values that all methods have agrees; None of too few methods, or without any."""
        known = self.known(kind, number)
        if len(known) < FEWEST:
            return None
        means = []
        for side in (self.twin, self.real):
            several = [side.values(name, kind, number) for name in known]
            shared = set.intersection(*({*values} for values in several))  # a method may have failed on a hard scene
            found = [estimate({key: values[key] for key in values if key in shared}) for values in several]
            means.append([each.value for each in found if each is not None])
        if min(map(len, means)) < len(known):
            return None
        return rank_correlation(*means)

    def differences(self, kind: str, number: str) -> list[Predicted]:
        """Every method less `against`."""
        known = self.known(kind, number)
        found = []
        for name in known if self.against in known else ():
            pair = [difference(*(side.values(each, kind, number) for each in (name, self.against)))
                    for side in (self.twin, self.real)]  # fmt: skip
            if name != self.against and pair[0] is not None and pair[1] is not None:
                found.append(Predicted(name, pair[0], pair[1]))
        return found

    def rows(self) -> list[dict[str, Any]]:
        """A row for each score and method, for a table."""
        return [
            {"score": f"{kind}.{number}", METHOD: each.method, "than": self.against,
             "twin": each.twin.value, "twin_error": each.twin.error, "real": each.real.value,
             "real_error": each.real.error, "agrees": each.agrees}
            for kind, number in SCORES for each in self.differences(kind, number)
        ]  # fmt: skip

    def lines(self) -> list[str]:
        """The verdict in lines of text."""
        said = []
        for kind, number in SCORES:
            if len(self.known(kind, number)) < FEWEST:
                continue
            order = self.order(kind, number)
            ordered = "no order: the methods have no value in common" if order is None else (
                f"rank correlation {order.value:.2f} of {order.methods} methods (p = {order.p:.2g})")  # fmt: skip
            apart = self.differences(kind, number)
            judged = [each.agrees for each in apart if each.agrees is not None]
            agree = f"{sum(judged)} of {len(judged)} differences to {self.against} agree" if judged else (
                "no errors are known of differences")  # fmt: skip
            said.append(f"{kind}.{number}: {ordered}; {agree}")
            for each in apart:
                differs = " (differs)" if each.agrees is False else ""
                twin, real = _signed(each.twin), _signed(each.real)
                said.append(f"  {each.method}: {twin} in the twin, {real} in reality{differs}")
        for ratio in self.noise:
            said.append(f"noise at {ratio.level:.3g} of white: {ratio.value:.2f} ± {ratio.error:.2f} times the real"
                        f"{' (differs)' if ratio.seen else ''}")  # fmt: skip
        return said


def _signed(found: Estimate) -> str:
    return f"{found.value:+.3g}" + ("" if found.error is None else f" ± {found.error:.2g}")


Pictures = tuple[torch.Tensor, torch.Tensor | None]  # of a view: 8-bit sRGB in 0..1, linear ones or None; [h,w,3]


def noise_ratios(twin: Sequence[Pictures], real: Sequence[Pictures]) -> list[NoiseRatio]:
    """Noise of the twin's pictures over noise of the real ones at `LEVELS` of the real light; [] of fewer than two
    views of a side. Linear pictures count where both sides have them.
    """
    if min(len(twin), len(real)) < 2:
        return []
    linear = all(light is not None for _, light in (*twin, *real))
    curves = [[noise_from(code[None], light[None] if linear and light is not None else None, None, mixed=False).linear16
               for code, light in side] for side in (twin, real)]  # fmt: skip
    greens = [(light if linear and light is not None else _decoded(code))[..., 1].flatten() for code, light in real]
    levels = torch.quantile(torch.cat([green[:: max(1, len(green) // 100_000)] for green in greens]).double(),
                            torch.tensor(LEVELS, dtype=torch.float64)).clamp_min(0)  # fmt: skip
    found = []
    for level in levels.tolist():
        here = torch.full((1, 3), level, dtype=torch.float64)
        logs = [np.log([max(float(curve(here)[0, 1]), 1e-30) for curve in side]) / 2 for side in curves]
        squares = [float(values.var(ddof=1)) / len(values) for values in logs]
        whole = sum(squares) + 2 * BETWEEN_SETS**2
        least = sum(square**2 / (len(values) - 1) for square, values in zip(squares, logs, strict=True))
        ratio, freedom = math.exp(fmean(logs[0]) - fmean(logs[1])), whole**2 / least if least else 1.0
        found.append(NoiseRatio(level, ratio, ratio * math.sqrt(whole), freedom))
    return found


def _decoded(code: torch.Tensor) -> torch.Tensor:
    from sensor_model.isp import srgb_to_linear

    return torch.from_numpy(np.asarray(srgb_to_linear(code.numpy()), np.float32))


def pictures_of(capture: Capture) -> list[Pictures]:
    """The training pictures of a capture."""
    deep = capture.holds("images16")
    return [(torch.from_numpy(capture.srgb8(i).copy()), torch.from_numpy(capture.linear16(i).copy()) if deep else None)
            for i in capture.cameras.train_indices]  # fmt: skip
