"""What is known of options before an experiment: curves measured earlier, or those that came with novags."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

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
    """The curves in a folder; without one those of `USUAL` if this machine made them, else those of novags.

    Args:
        folder: The folder that is named, if any.
        methods: The methods of the experiment; see `options_of`. What `USUAL` lacks of them comes from novags.

    Raises:
        ValueError: If the folder that is named holds no curves of options.
    """
    own = [] if folder is not None else _measured_here()
    points = [*own, *read_curves(SHIPPED if folder is None else folder)]
    used = _used(points, methods)
    here = [name for name in used if name in _subjects(own)]
    rest = [point for point in points[len(own) :] if _subject(point) not in here]
    with reading(SHIPPED if folder is None else folder, "measure it again with novags pareto METHOD"):
        found = options_of([point for point in [*own, *rest] if _subject(point) in used], methods)
    if not found:
        raise ValueError(
            f"{folder} holds no curves of whole reconstructions: novags pareto METHOD --out {quote(str(folder))} "
            "measures them"
        )
    sources = [f"measured earlier on this machine ({USUAL})"] if here else []
    if others := [name for name in used if name not in here]:
        first = next(point for point in _points_of_options(rest) if _subject(point) in others)
        work, machine = spelled(first["workload"]), first["hardware"].get("processor")
        where = "that came with novags" if folder is None else f"in {folder}"
        which = f"{' and '.join(others)}, " if len(used) > 1 else ""
        sources.append(f"{where} ({which}measured on {machine}: {work})")
    defaults = (point for point in [*own, *rest] if point["default"] and _subject(point) in used)
    return Known(found, " and those ".join(sources), tuple(defaults))


def _measured_here() -> list[Point]:
    if not (USUAL / CURVES).exists():
        return []
    here = jsonable(hardware())
    return [point for point in _points_of_options(read_curves(USUAL)) if point["hardware"] == here]


def options_of(points: Sequence[Point], methods: Collection[str] = ()) -> dict[str, list[Option]]:
    """The options of some curves; settings above the default are left out.

    What was measured to be better than the default at less time counts as no loss: it may be chance.

    Args:
        points: Of one method or of several.
        methods: Whose curves are wanted; together where there are several (`united`). Of none of these, or of no name:
            the first method that the curves are of.
    """
    used = _used(points, methods)
    found = [_options_of([point for point in points if _subject(point) == name]) for name in used]
    names = dict.fromkeys(option for curves in found for option in curves)
    return {name: refined(united([curves[name] for curves in found if name in curves])) for name in names}


def _options_of(points: Sequence[Point]) -> dict[str, list[Option]]:
    found: dict[str, list[Option]] = {}
    for point in _points_of_options(points):
        default = next((p for p in points if p["knob"] == point["knob"] and p["default"]), None)
        _check(point)
        if default is None or point["setting"] > default["setting"] or point["db_lost"] is None:
            continue
        factors = {
            part: point["parts"].get(part, seconds) / seconds
            for part, seconds in default["parts"].items()
            if seconds > 0
        }
        option = Option(
            name=point["option"], share=point["setting"] / default["setting"], factors=factors,
            lost=max(0.0, point["db_lost"]), sd=point["db_lost_sd"] or 0.0,
        )  # fmt: skip
        found.setdefault(option.name, []).append(option)
    return found


def _subject(point: Point) -> str:
    name: str = point["knob"].partition(".")[0]
    return name


def _subjects(points: Sequence[Point]) -> list[str]:
    return list(dict.fromkeys(_subject(point) for point in _points_of_options(points)))


def _used(points: Sequence[Point], methods: Collection[str]) -> list[str]:
    subjects = _subjects(points)
    return [name for name in subjects if name in methods] or subjects[:1]


def _check(point: Point) -> None:
    """Refuse what has no logarithm: a setting of nothing, a part that takes less than no time."""
    setting, parts = point["setting"], point["parts"]
    if not isinstance(setting, int | float) or not setting > 0 or min(parts.values(), default=0) < 0:
        raise ValueError(f"the settings of {point['knob']} must be numbers > 0 and the seconds of its parts >= 0, got "
                         f"{brief(setting, 60)} and {brief(parts, 100)}")  # fmt: skip


def _points_of_options(points: Sequence[Point]) -> list[Point]:
    return [point for point in points if point["option"] is not None]


def open_options(
    preset: Preset, options: Mapping[str, Sequence[Option]], decided: Collection[str]
) -> dict[str, list[Option]]:
    """The options that a budget may choose, with the settings that make sense for a preset.

    Args:
        preset: The experiment.
        options: What curves know.
        decided: Options that the user has set.
    """
    own = values(preset)
    found = {
        name: [s for s in settings if s.share == 1 or own[name] * s.share >= LEAST[name]]
        for name, settings in options.items() if name in own and name not in decided
    }  # fmt: skip
    return {name: settings for name, settings in found.items() if len(settings) > 1}
