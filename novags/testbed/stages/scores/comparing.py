"""Runs of one capture compared view by view: gains over the floor, and shares of the cost of noise that each wins."""

import json
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from novags.methods import METHODS
from novags.testbed.metrics.differences import LEVEL, Estimate, Values, difference, is_span, quantile, share
from novags.testbed.metrics.truth import ERROR

# dB between the floor and the ceiling. Methods differ in more than what they do with noise: other learning rates alone
# move the ceiling by .8 dB (docs/nova-plus.md), so that a share of less would say little of noise.
NO_GAIN = 1.0
# column: the reference, the score
SHARES = {"recovered": ("enhanced", "aligned_psnr"), "recovered_lit": ("lit", "tone_aligned_psnr")}


def values_of(method: Mapping[str, Any], kind: str, number: str, scene: str = "", seed: str = "") -> Values:
    """A score of a run by held-out view; its mean alone where the views are not known; {} without the score.

    Args:
        method: The scores of the run.
        kind: The reference, or "geometry".
        number: The score.
        scene: Of the run, for its values.
        seed: Likewise.
    """
    views = method.get("views") or {}
    if kind == "geometry":
        views = {name: {kind: own} for name, own in ((method.get(kind) or {}).get("views") or {}).items()}
    mean = method.get(kind) if kind in ("geometry", "noise") else (method.get("mean") or {}).get(kind)
    if (whole := (mean or {}).get(number)) is None or isinstance(whole, Mapping):
        return {}
    found = {name: (own.get(kind) or {}).get(number) for name, own in views.items()}
    known = {(scene, seed, name): float(value) for name, value in found.items() if value is not None}
    return known or {(scene, seed, ""): float(whole)}


def enhancement_of(record: Mapping[str, Any]) -> str:
    """What a run's noise-free reference is enhanced by, by its run.json, as text to compare; "" where nothing is."""
    found = record.get("enhancement") or {}
    return json.dumps([found.get("enhancer"), found.get("config")], sort_keys=True) if found else ""


def mean_values(several: list[Values]) -> Values:
    """The mean of the values of several runs, where all have one."""
    keys = [key for key in several[0] if all(key in other for other in several)]
    return {key: float(np.mean([values[key] for values in several])) for key in keys}


def recovered_shares(
    scores: Mapping[str, Any], methods: Mapping[str, str], enhancements: Mapping[str, str]
) -> tuple[dict[str, dict[str, Estimate]], dict[str, str]]:
    """The share of the cost of noise that each run wins back: `recovered` and `recovered_lit`, by run; and why one is
    not known.

    `recovered` = (method - floor) / (ceiling - floor) in aligned PSNR against `enhanced`, `recovered_lit` the same in
    tone-aligned PSNR against `lit`, for every run but the bounds.

    Args:
        scores: The scores of each run, by its name.
        methods: The method of each run, by its name.
        enhancements: `enhancement_of` each run, by its name.
    """
    shares, unavailable = dict[str, dict[str, Estimate]](), dict[str, str]()
    for column, (kind, number) in SHARES.items():
        shares[column], why = recovered_fractions(scores, methods, kind, number, enhancements)
        if why is not None:
            unavailable[column] = why
    return shares, unavailable


def recovered_fractions(
    scores: Mapping[str, Any],
    methods: Mapping[str, str],
    kind: str = "enhanced",
    number: str = "aligned_psnr",
    enhancements: Mapping[str, str] = MappingProxyType({}),
) -> tuple[dict[str, Estimate], str | None]:
    """The share of the cost of noise that each run wins back, and the reason where it is unknown.

    Args:
        scores: The scores of each run, by its name, which may follow a folder and a slash.
        methods: The method of each run, by its name.
        kind: The reference.
        number: The score.
        enhancements: `enhancement_of` each run, by its name: where it is not the bounds', the noise-free references
            differ and no share is known.
    """
    for needed, what in ((kind, f"the reference {kind}"), ("enhanced", "the noise-free exposure, the ceiling's,")):
        if all(method["mean"].get(needed, {}) is None for method in scores.values()):
            return {}, f"{what} is not known for these photographs, so the recovered share cannot be measured"
    ends = bounds_of(methods)
    if len(ends) < 2:
        wanted = [name for name, method in METHODS.items() if method.bound and method.bound not in ends]
        listed = " and ".join(wanted)
        return {}, f"the recovered fraction needs the method(s) {listed}: reconstruct and score them too"
    value = {name: found for name, method in scores.items() if (found := values_of(method, kind, number))}
    if missing := [name for names in ends.values() for name in names if name not in value]:
        if all(number in (scores[name]["mean"].get(kind) or {}) for name in missing):
            return {}, f"{' and '.join(missing)} have no {number} against {kind}: nothing to measure recovery by"
        return {}, f"{' and '.join(missing)} were scored by an earlier version: score them again"
    floor, ceiling = (mean_values([value[name] for name in ends[end]]) for end in ("floor", "ceiling"))
    span = difference(ceiling, floor)
    if span is None or not is_span(span, NO_GAIN):
        return {}, (
            f"{ends['ceiling'][0]} is {'' if span is None else said(span) + ' '}from {ends['floor'][0]}: no share is "
            f"made of less than {NO_GAIN:g} dB, which rates and losses alone can make, of less than three standard "
            "errors, or of a difference whose 95 % interval has 0 in it"
        )
    bounds = {name for names in ends.values() for name in names}
    value = _of_one_reference(value, bounds, kind, enhancements)
    if not bounds <= value.keys():
        return {}, f"{ends['floor'][0]} and {ends['ceiling'][0]} are enhanced by different settings: no share is known"
    shares = {name: share(value[name], floor, ceiling, NO_GAIN) for name in value if name not in bounds}
    return {name: found for name, found in shares.items() if found is not None}, None


def _of_one_reference(
    values: dict[str, Values], bounds: Iterable[str], kind: str, enhancements: Mapping[str, str]
) -> dict[str, Values]:
    """The runs that share the reference of the bounds: every run has its own enhancement of the noise-free exposure."""
    if kind != "enhanced":
        return values
    tones = {enhancements.get(name) for name in bounds}
    return {name: own for name, own in values.items() if tones == {enhancements.get(name)}}


def with_errors(estimates: Mapping[str, Estimate]) -> dict[str, float | None]:
    """Estimates as columns of a table: each value, and its standard error beside it."""
    return {name: value for column, found in estimates.items()
            for name, value in ((column, found.value), (column + ERROR, found.error))}  # fmt: skip


def gains(span: Estimate | None) -> bool | None:
    """Whether the ceiling is above the floor by more than other rates would make; None where the error is too large to
    tell.
    """
    if span is None:
        return False
    above = 0.0 if span.error is None else quantile(span.freedom, 2 * LEVEL - 1) * span.error  # one side alone counts
    if span.value + above <= NO_GAIN:
        return False
    return True if span.error is None or is_span(span, NO_GAIN) else None


def said(found: Estimate, unit: str = " dB") -> str:
    """A difference in words, with its standard error and what that is over."""
    error = "" if found.error is None else f" ± {found.error:.2f}"
    return f"{found.value:+.2f}{error}{unit} ({found.where})"


def bounds_of(methods: Mapping[str, str]) -> dict[str, list[str]]:
    """The runs at each end of the scale, "floor" and "ceiling": methods themselves, not variants of them.

    Args:
        methods: The method of each run, by its name, which may follow a folder and a slash.
    """
    found: dict[str, list[str]] = {}
    for name, method in methods.items():
        row = METHODS.get(method)
        if row is not None and row.bound is not None and name.rpartition("/")[2] == method:
            found.setdefault(row.bound, []).append(name)
    return found


def deltas(
    scores: Mapping[str, Any], methods: Mapping[str, str], kind: str, number: str, enhancements: Mapping[str, str]
) -> tuple[dict[str, Estimate], str]:
    """How far each run is above the floor (without one: above the first run), and the name of that baseline.

    Args:
        scores: The scores of each run, by its name.
        methods: The method of each run, by its name.
        kind: The reference.
        number: The score.
        enhancements: `enhancement_of` each run, by its name: runs of another one than the baseline's are left out.
    """
    value = {name: found for name, method in scores.items() if (found := values_of(method, kind, number))}
    base = [name for name in bounds_of(methods).get("floor", []) if name in value] or list(value)[:1]
    if not base:
        return {}, ""
    level = mean_values([value[name] for name in base])
    value = _of_one_reference(value, base, kind, enhancements)
    what = base[0] if len(base) == 1 else f"the mean of {len(base)} runs of {methods[base[0]]}"
    apart = {name: difference(found, level) for name, found in value.items() if [name] != base}
    return {name: found for name, found in apart.items() if found is not None}, what
