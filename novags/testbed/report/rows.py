"""How a run appears in a report: title, family and colour, and where its settings differ from the published method."""

import colorsys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from novags.methods import METHODS, chosen, title_of
from novags.methods.variant import STATISTICS, Variant, dotted, sees_statistics
from novags.settings import changed, flattened, has_setting
from novags.testbed.folders.run import Run
from novags.testbed.ledger.contents import jsonable
from novags.testbed.ledger.difference import flat
from novags.testbed.stages.scores.comparing import enhancement_of

OTHER = "#777777"  # of a method that this version does not have
UNLISTED = ("fit.checkpoint_every", "fit.seed", "fit.extent", "fit.backend")  # what every run sets for itself


@dataclass(frozen=True)
class Row:
    """One run in tables and charts."""

    name: str  # of the run
    key: str  # of its CSS class
    method: str  # of the method
    title: str  # its work
    family: str  # of the method
    color: str  # "#rrggbb", different for every run of a report
    bound: str | None  # "floor", "ceiling" or None, for a method with its own settings; a variant is not a bound
    competes: bool  # whether it may be the best: a method that sees any truth may not
    enhancement: str  # what its noise-free reference is enhanced by: runs that differ in it have no reference in common


def rows_of(runs: Mapping[str, Run]) -> dict[str, Row]:
    """The rows of a report's runs, by name, in their order."""
    rows, used = {}, list[str]()
    for k, (name, run) in enumerate(runs.items()):
        method = METHODS.get(run.method)
        title = str(run.record.get("title", "" if method is None else method.title))
        color = distinct(OTHER if method is None else method.color, used)
        used.append(color)
        rows[name] = Row(
            name=name, key=f"m{k}", method=run.method, title=title, family="" if method is None else method.family,
            color=color, bound=method.bound if method is not None and run.name == run.method else None,
            competes=not (saw_truth(run) or sees_statistics(run.record.get("config"))),
            enhancement=enhancement_of(run.record),
        )  # fmt: skip
    return rows


def saw_truth(run: Run) -> bool:
    """Whether the method of a run sees the truth of training views; of one that is not here, what the run recorded."""
    if (method := METHODS.get(run.method)) is None:
        return run.record.get("sees_truth") is True
    return method.sees_clean or method.sees_surface


def looks_of(names: Iterable[str], study: Mapping[str, Any], runs: Mapping[str, Run] | None = None) -> dict[str, Row]:
    """The rows of a study's methods, variants and programs, by name, in their order; also without a run.

    `study`: the content of its file, with the tables of its own variants and programs, and its settings for all.
    `runs`: one of each, of those that have any: of methods that are not here it alone knows the title.
    """
    programs = study.get("method", {})
    # Not checked as those of a study to be run: a variant may be of a method that is not here any more.
    variants = {
        name: Variant(name=name, method=str(table["method"]),
                      settings={key: value for key, value in dotted(table).items() if key != "method"})
        for name, table in study.get("variant", {}).items()
    }  # fmt: skip
    shared, found, used = dotted(study.get("override", {})), dict[str, Row](), list[str]()
    for name in names:
        variant = None if name in programs or not _is_known(name, variants) else chosen(name, variants)
        method = None if variant is None else METHODS[variant.method]
        used.append(distinct(OTHER if method is None else method.color, used))
        run = (runs or {}).get(name)
        sees = run is not None and saw_truth(run) if variant is None else _sees_truth(variant, shared)
        title = "" if variant is None else title_of(variant.method)
        found[name] = Row(
            name=name, key=f"m{len(found)}", method=name if variant is None else variant.method,
            title=title if run is None else str(run.record.get("title", title)),
            family="" if method is None else method.family, color=used[-1], bound=None, competes=not sees,
            enhancement="",
        )  # fmt: skip
    return found


def _is_known(name: str, variants: Mapping[str, Variant]) -> bool:
    """Whether there is such a method here; a study may have one of a plugin, or of a package that is broken now."""
    with suppress(ValueError):
        return METHODS.get(chosen(name, variants).method) is not None
    return False


def _sees_truth(variant: Variant, shared: Mapping[str, Any]) -> bool:
    """Whether a variant, under what the study sets for all, sees any truth."""
    method = METHODS[variant.method]
    told = {key: value for key, value in {**shared, **variant.settings}.items() if key == STATISTICS}
    config = method.config()
    own = changed(config, told) if has_setting(config, STATISTICS) else config
    return method.sees_clean or method.sees_surface or sees_statistics(own)


def main_row(rows: Iterable[Row]) -> str:
    """The main run of a report: the first of our methods, else the first that competes."""
    listed = list(rows)
    ours = [row.name for row in listed if row.family == "ours"]
    others = [row.name for row in listed if row.competes and row.bound is None]
    return (ours or others or [listed[0].name])[0]


BRIGHTEST = 0.3  # relative luminance: a lighter line would vanish on a white page


def distinct(color: str, used: Iterable[str]) -> str:
    """The colour itself, or one of another hue and lightness if it is used already."""
    taken, found, turn = set(used), color, 0
    red, green, blue = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    hue, light, strength = colorsys.rgb_to_hls(red, green, blue)
    while found in taken:
        turn += 1
        level = min(0.6, max(0.3, light + (0.14 if turn % 2 else -0.06)))
        # Grey has no hue to turn: without some strength of colour the search would not end.
        shifted = colorsys.hls_to_rgb((hue + 0.09 * turn) % 1, level, max(strength, 0.45))
        luminance = sum(weight * part**2.2 for weight, part in zip((0.2126, 0.7152, 0.0722), shifted, strict=True))
        dimmed = (part * min(1.0, (BRIGHTEST / luminance) ** (1 / 2.2)) for part in shifted)
        found = "#" + "".join(f"{round(255 * part):02x}" for part in dimmed)
    return found


@dataclass(frozen=True)
class Deviation:
    """A setting that differs from the published method's."""

    setting: str
    published: str
    here: str


def deviations(run: Run) -> list[Deviation]:
    """Every setting in which a run differs from its method as published, from its recorded configuration.

    Settings of size count too, but not what every run must set: seed, extent, the cadence of checkpoints.
    """
    method = METHODS.get(run.method)
    if method is None:
        return []
    published = jsonable(flattened(method.config()))
    here = flat(run.record["config"])
    found = []
    source = str((run.record.get("cameras") or {}).get("source", "known"))
    if method.cameras is not None and not source.startswith(method.cameras):
        found.append(Deviation("cameras", method.cameras, source))
    for name in dict.fromkeys((*published, *here)):
        if name in UNLISTED:
            continue
        a, b = _value(published, name), _value(here, name)
        if a != b:
            found.append(Deviation(name, a, b))
    return found


def _value(config: Mapping[str, Any], name: str) -> str:
    if name not in config:  # a part above it is switched off, or this version does not have it
        return "off"
    value = config[name]
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    return "off" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
