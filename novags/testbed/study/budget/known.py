"""Knowledge of options before an experiment: curves measured earlier, or curves that came with novags."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from novags.testbed.console.provenance import hardware
from novags.testbed.ledger.contents import jsonable
from novags.testbed.study.budget.choice import Option, refined, united
from novags.testbed.study.cells.presets import Preset
from novags.testbed.study.curves.curve import CURVES, Point, read_curves
from novags.testbed.study.knobs.knob import spelled
from novags.testbed.study.knobs.options import LEAST, values
from sensor_model.files.reading import brief, reading

SHIPPED = Path(__file__).resolve().parents[1] / "curves" / "shipped.jsonl"
USUAL = Path("out") / "pareto"  # where docs/accuracy-and-time.md puts curves


@dataclass(frozen=True)
class Known:
    """Settings of options with their factors and losses.

    Attributes:
        options: By name, with the preset's own value (share 1) in each.
        source: Where they come from, in a sentence.
        points: The points of the curves that are defaults, of the methods that are used.
    """

    options: dict[str, list[Option]]
    source: str
    points: tuple[Point, ...] = ()


def known(folder: Path | None, methods: Collection[str] = ()) -> Known:
    """The curves in a folder; without one the curves of `USUAL` if this machine made them, else novags's own.

    Args:
        folder: The folder that is named, if any.
        methods: The methods of the experiment; see `options_of`. Curves that `USUAL` lacks come from novags.

    Raises:
        ValueError: If the folder that is named holds no curves of options.
    """
    place = SHIPPED if folder is None else folder
    here = _by_subject(_measured_here()) if folder is None else {}
    curves = {**_by_subject(read_curves(place)), **here}
    used = _used({**here, **curves}, methods)
    points = [point for name in used for point in curves[name]]
    with reading(place, "measure it again with novags pareto METHOD"):
        found = options_of(points, methods)
    if not found:
        raise ValueError(
            f"{folder} holds no curves of whole reconstructions: novags pareto METHOD --out {quote(str(folder))} "
            "measures them"
        )
    sources = [f"measured earlier on this machine ({USUAL})"] if here.keys() & used else []
    if others := [name for name in used if name not in here]:
        first = next(point for point in curves[others[0]] if point["option"] is not None)
        work, machine = spelled(first["workload"]), first["hardware"].get("processor")
        where = "that came with novags" if folder is None else f"in {folder}"
        which = f"{' and '.join(others)}, " if len(used) > 1 else ""
        sources.append(f"{where} ({which}measured on {machine}: {work})")
    return Known(found, " and those ".join(sources), tuple(point for point in points if point["default"]))


def _measured_here() -> list[Point]:
    here = jsonable(hardware())
    there = read_curves(USUAL) if (USUAL / CURVES).exists() else []
    return [point for point in there if point["hardware"] == here]


def _by_subject(points: Sequence[Point]) -> dict[str, list[Point]]:
    """The curves of each subject that has some of options, in their order."""
    names = dict.fromkeys(subject(point) for point in points if point["option"] is not None)
    return {name: [point for point in points if subject(point) == name] for name in names}


def _used(curves: Collection[str], methods: Collection[str]) -> list[str]:
    return [name for name in curves if name in methods] or list(curves)[:1]


def subject(point: Mapping[str, Any]) -> str:
    """The subject of a point."""
    return str(point["knob"]).partition(".")[0]


def options_of(points: Sequence[Point], methods: Collection[str] = ()) -> dict[str, list[Option]]:
    """The options of some curves; settings above the default are left out.

    A setting that was measured to be better than the default at less time counts as no loss: it may be chance.

    Args:
        points: Of one method or of several.
        methods: Whose curves are wanted; together where there are several (`united`). Of none of these, or of no name:
            the first method that the curves are of.
    """
    curves = _by_subject(points)
    found = [_options_of(curves[name]) for name in _used(curves, methods)]
    names = dict.fromkeys(option for own in found for option in own)
    return {name: refined(united([own[name] for own in found if name in own])) for name in names}


def _options_of(points: Sequence[Point]) -> dict[str, list[Option]]:
    found: dict[str, list[Option]] = {}
    defaults = {point["knob"]: point for point in points if point["default"]}
    for point in points:
        if point["option"] is None:
            continue
        setting, parts, default = point["setting"], point["parts"], defaults.get(point["knob"])
        # numbers without a logarithm: a setting of nothing, a part that takes less than no time
        if not isinstance(setting, int | float) or not setting > 0 or min(parts.values(), default=0) < 0:
            raise ValueError(f"the settings of {point['knob']} must be numbers > 0 and the seconds of its parts >= 0, "
                             f"got {brief(setting, 60)} and {brief(parts, 100)}")  # fmt: skip
        if default is None or setting > default["setting"] or point["db_lost"] is None:
            continue
        factors = {part: parts.get(part, s) / s for part, s in default["parts"].items() if s > 0}
        found.setdefault(point["option"], []).append(Option(
            name=point["option"], share=setting / default["setting"], factors=factors,
            lost=max(0.0, point["db_lost"]), sd=point["db_lost_sd"] or 0.0,
        ))  # fmt: skip
    return found


def open_options(
    preset: Preset, options: Mapping[str, Sequence[Option]], decided: Collection[str]
) -> dict[str, list[Option]]:
    """The options that a budget may choose, with the settings that make sense for a preset.

    Args:
        preset: The experiment.
        options: The options of the curves.
        decided: Options that the user has set.
    """
    own = values(preset)
    found = {
        name: [s for s in settings if s.share == 1 or own[name] * s.share >= LEAST[name]]
        for name, settings in options.items() if name in own and name not in decided
    }  # fmt: skip
    return {name: settings for name, settings in found.items() if len(settings) > 1}
