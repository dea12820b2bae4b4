"""What is known of options before an experiment: curves measured earlier, or those that came with novags."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from novags.testbed.budget.choice import Option, refined
from novags.testbed.cache import jsonable
from novags.testbed.machine.provenance import hardware
from novags.testbed.pareto.curve import CURVES, Point, read_curves
from novags.testbed.pareto.knob import spelled
from sensor_model.files.reading import brief, reading

SHIPPED = Path(__file__).resolve().parents[1] / "pareto" / "shipped.jsonl"
USUAL = Path("out") / "pareto"  # where docs/accuracy-and-time.md puts curves


@dataclass(frozen=True)
class Known:
    """Settings of options with their factors and losses.

    Attributes:
        options: By name, with the preset's own value (share 1) in each.
        source: Where they come from, in a sentence.
    """

    options: dict[str, list[Option]]
    source: str


def known(folder: Path | None) -> Known:
    """The curves in a folder; without one those of `USUAL` if this machine made them, else those of novags.

    Raises:
        ValueError: If the folder that is named holds no curves of options.
    """
    if folder is None and (USUAL / CURVES).exists():
        points = read_curves(USUAL)
        if _points_of_options(points) and _hardware(points) == jsonable(hardware()):
            return Known(known(USUAL).options, f"measured earlier on this machine ({USUAL})")
    points = read_curves(SHIPPED if folder is None else folder)
    with reading(SHIPPED if folder is None else folder, "measure it again with novags pareto nova"):
        found = options_of(points)
    if not found:
        raise ValueError(
            f"{folder} holds no curves of whole reconstructions: novags pareto nova --out {folder} measures them"
        )
    first = _points_of_options(points)[0]
    work, machine = spelled(first["workload"]), first["hardware"].get("processor")
    where = "that came with novags" if folder is None else f"in {folder}"
    return Known(found, f"{where} (measured on {machine}: {work})")


def options_of(points: Sequence[Point]) -> dict[str, list[Option]]:
    """The options of some curves; settings above the default are left out.

    What was measured to be better than the default at less time counts as no loss: it may be chance.
    """
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
    return {name: refined(settings) for name, settings in found.items()}


def _check(point: Point) -> None:
    """Refuse what has no logarithm: a setting of nothing, a part that takes less than no time."""
    setting, parts = point["setting"], point["parts"]
    if not isinstance(setting, int | float) or not setting > 0 or min(parts.values(), default=0) < 0:
        raise ValueError(f"the settings of {point['knob']} must be numbers > 0 and the seconds of its parts >= 0, got "
                         f"{brief(setting, 60)} and {brief(parts, 100)}")  # fmt: skip


def _points_of_options(points: Sequence[Point]) -> list[Point]:
    return [point for point in points if point["option"] is not None]


def _hardware(points: Sequence[Point]) -> object:
    return _points_of_options(points)[0]["hardware"]
