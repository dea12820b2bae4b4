"""The verdict of a comparison: the difference of changed to base with its error, and the costs of both."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import fmean
from typing import Any

from novags.testbed.metrics import METRICS
from novags.testbed.metrics.differences import Estimate, Values, estimate, shift_seen
from novags.testbed.stages.scores.comparing import enhancement_of
from novags.testbed.study.differences import ALL, SCENE, Finished, rows_of
from novags.testbed.study.light import METHOD
from novags.testbed.study.versions.pairs import Fit, Pair

ROLES = ("base", "changed")


@dataclass(frozen=True)
class ComparisonVerdict:
    """Both sides of one method, or two methods."""

    names: Mapping[str, str]  # what base and changed are
    pairs: Sequence[Pair]

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """Changed less base, by score and scene, and over all scenes, as in differences.csv."""
        runs = []
        for pair in self.pairs:
            for role, fit in zip(ROLES, (pair.base, pair.changed), strict=True):
                # Captures of one scene may differ in more than their noise: each is a repeat of its own.
                place = {SCENE: pair.case.scene, "seed": pair.case.name, METHOD: role}
                runs.append(Finished(place, fit.run.method, fit.scores, enhancement_of(fit.run.record)))
        return rows_of({METHOD: ROLES}, runs)

    @cached_property
    def whole(self) -> list[dict[str, Any]]:
        """Of these the rows over all scenes; of one scene all rows."""
        return [row for row in self.rows if row[SCENE] == ALL] or self.rows

    @property
    def same(self) -> bool:
        """Whether all pictures are the same, bit for bit."""
        return all(pair.same for pair in self.pairs)

    @property
    def below(self) -> bool:
        """Whether changed is seen to be below base in a main score."""
        return not self.same and any(row["seen"] and row["difference"] < 0 for row in self.whole)

    @property
    def headline(self) -> str:
        """The verdict in a sentence."""
        if self.same:
            return f"{self._named('changed')} shows the same pictures as {self._named('base')}, bit for bit."
        row = next(iter(self.whole), None)
        if row is None:
            return "The pictures differ, and no main score is known of both."
        if row["error"] is None:
            return f"No error is known, because nothing repeats: {_measured(row)}."
        if seen := [each for each in self.whole if each["seen"]]:
            told, before = self._named("changed"), ""
            for each in seen:
                where = "above" if each["difference"] > 0 else "below"
                told += (
                    "" if where == before else f" and {where} it" if before else f" is {where} {self._named('base')}"
                )
                told += f"{' and' if where == before else ''} by {_measured(each).lstrip('+-')}"
                before = where
            return f"{told}."
        least = shift_seen(row["freedom"]) * row["error"]
        return (f"No difference is seen: {_measured(row)}; the smallest that this comparison sees four times in five "
                f"is {least:.2g} dB.")  # fmt: skip

    @cached_property
    def ratio(self) -> Estimate | None:
        """The logarithm of the processor seconds of changed over those of base, paired."""
        values: Values = {
            (pair.case.scene, pair.case.name, ""): math.log(changed / base)
            for pair in self.pairs
            if (base := pair.base.cpu_seconds) and (changed := pair.changed.cpu_seconds)
        }
        return estimate(values)

    def lines(self) -> list[str]:
        """For a terminal, the headline last."""
        width = max([len(_called(row["score"])) for row in self.whole] + [len("processor seconds")])
        found = [f"{self._named('changed')} less {self._named('base')}, {len(self.pairs)} pairs of fits:"]
        for row in self.rows:
            scene = "" if row in self.whole else f", {row[SCENE]}"
            span = ", no error is known"
            if row["error"] is not None:
                span = ", 95 %: {low:+{0}} to {high:+{0}}".format(_digits(row["error"]), **row)
            found.append(f"  {_called(row['score']):<{width}}  {_shown(row)}{span} ({_counts(row)}){scene}")
        costs = {role: _costs(fits) for role, fits in zip(ROLES, self._fits(), strict=True)}
        if self.ratio is not None:
            ratio, half = math.exp(self.ratio.value), self.ratio.half
            span = "" if half is None or self.ratio.error is None else (
                f" ± {ratio * self.ratio.error:.3f}, 95 %: {ratio * math.exp(-half):.3f} to "
                f"{ratio * math.exp(half):.3f}")  # fmt: skip
            found.append(f"  {'processor seconds':<{width}}  {costs['changed']['cpu_seconds']:.1f} (changed) and "
                         f"{costs['base']['cpu_seconds']:.1f} (base) a fit: {ratio:.3f} times{span}")  # fmt: skip
        found.append(f"  {'peak memory':<{width}}  " + " and ".join(
            f"{costs[role]['peak_bytes'] / 1e6:.0f} ({role})" for role in reversed(ROLES)) + " MB")  # fmt: skip
        return [*found, self.headline]

    def record(self) -> dict[str, Any]:
        """For compare.json."""
        ratio = self.ratio
        return {
            "headline": self.headline, "same_pictures": self.same, "scores": self.rows,
            "cost": {role: _costs(fits) for role, fits in zip(ROLES, self._fits(), strict=True)},
            "log_cpu_ratio": None if ratio is None else {"value": ratio.value, "error": ratio.error,
                                                         "freedom": ratio.freedom, "half": ratio.half},
            "pairs": [{"scene": pair.case.scene, "noise": pair.case.noise, "seed": pair.case.seed, "same": pair.same,
                       **{role: fit.run.path.name for role, fit in zip(ROLES, (pair.base, pair.changed), strict=True)},
                       "code": [fit.run.record["stage"]["code"] for fit in (pair.base, pair.changed)]}
                      for pair in self.pairs],
        }  # fmt: skip

    def _named(self, role: str) -> str:
        return f"{role} ({self.names[role]})"

    def _fits(self) -> tuple[list[Fit], list[Fit]]:
        return [pair.base for pair in self.pairs], [pair.changed for pair in self.pairs]


def _costs(fits: Sequence[Fit]) -> dict[str, Any]:
    known = [fit.cpu_seconds for fit in fits if fit.cpu_seconds is not None]
    return {"cpu_seconds": fmean(known) if known else None, "peak_bytes": max(fit.run.peak_bytes for fit in fits)}


def _digits(error: float) -> str:
    """As many digits as show two of the error, and two at least."""
    return f".{2 if error >= 0.1 or error <= 0 else min(6, 1 - math.floor(math.log10(error)))}f"


def _shown(row: Mapping[str, Any]) -> str:
    value, error = row["difference"], row["error"]
    return f"{value:+.2f} dB" if error is None else f"{value:+{_digits(error)}} ± {error:{_digits(error)}} dB"


def _measured(row: Mapping[str, Any]) -> str:
    return f"{_shown(row)} ({_called(row['score'])}; {_counts(row)})"


def _called(score: str) -> str:
    kind, _, number = score.partition(".")
    return f"{METRICS[number].heading}, {'noise-free' if kind == 'enhanced' else kind}"


def _counts(row: Mapping[str, Any]) -> str:
    named = ((row[what], called) for what, called in (("scenes", "scene"), ("seeds", "fit"), ("views", "view")))
    return ", ".join(f"{count} {what}{'' if count == 1 else 's'}" for count, what in named)
