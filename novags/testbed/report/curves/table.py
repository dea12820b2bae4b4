"""Curves as tables: one for each knob, with a sentence on its default, or one of all knobs."""

from collections.abc import Mapping, Sequence
from typing import Any

from novags.testbed.report.curves.figure import setting_text, with_spread
from novags.testbed.study.curves.front import beaten_by
from novags.testbed.study.knobs.knob import spelled

Point = Mapping[str, Any]


def tables(points: Sequence[Point]) -> str:
    """Every knob of some curves, in their order."""
    knobs = list(dict.fromkeys(point["knob"] for point in points))
    return "\n".join(_table(knob, [point for point in points if point["knob"] == knob]) for knob in knobs)


def _table(knob: str, points: Sequence[Point]) -> str:
    decibels = any(point["db_lost"] for point in points) and "RMSE of held-out views" in points[0]["error_unit"]
    unit = points[0]["error_unit"].replace("|", r"\|")  # or it would end the cell
    head = [knob.partition(".")[2], "processor s", "wall s", f"error ({unit})",
            *(["lost to the default"] if decibels else []), "on the front"]  # fmt: skip
    lines = [f"#### {knob}", "", f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for point in points:
        setting = setting_text(point["setting"])
        cells = [
            f"**{setting}** (default)" if point["default"] else setting, f"{point['cpu_seconds']:.3g}",
            f"{point['seconds']:.3g}", with_spread(point["error"], point["error_sd"], point["repeats"]),
            *([_decibels(point)] if decibels else []), "yes" if point["front"] else "",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", said(points), ""])


def joined(points: Sequence[Point]) -> list[list[str]]:
    """The tables of all knobs as one, a row a setting; the head first."""
    rows = [["knob", "setting", "default", "processor s", "wall s", "error", "unit", "lost to the default",
             "on the front", "reason"]]  # fmt: skip
    for knob in dict.fromkeys(point["knob"] for point in points):
        own = [point for point in points if point["knob"] == knob]
        for point in own:
            rows.append([
                knob, setting_text(point["setting"]), "yes" if point["default"] else "",
                f"{point['cpu_seconds']:.3g}", f"{point['seconds']:.3g}",
                with_spread(point["error"], point["error_sd"], point["repeats"]), point["error_unit"],
                _decibels(point) if "RMSE of held-out views" in point["error_unit"] else "",
                "yes" if point["front"] else "", said(own) if point["default"] else "",
            ])  # fmt: skip
    return rows


def _decibels(point: Point) -> str:
    if point["db_lost"] is None:
        return ""
    return "0" if point["default"] else f"{with_spread(point['db_lost'], point['db_lost_sd'], point['repeats'])} dB"


def said(points: Sequence[Point]) -> str:
    """Where the default of a knob lies, and why it is the default."""
    default = next((point for point in points if point["default"]), None)
    if default is None:
        return "The default is not measured yet."
    place = "is on the front" if default["front"] else _off_the_front(default, points)
    return f"The default, {setting_text(default['setting'])}, {place}: {default['why']}."


def _off_the_front(default: Point, points: Sequence[Point]) -> str:
    if min(point["repeats"] for point in points) < 2:
        return "is off the front; a single measurement has no known spread"
    clear = beaten_by(_spread(default), [_spread(point) for point in points])
    if not clear:
        return "is off the front, but nothing is both faster and more accurate beyond the spread"
    names = ", ".join(setting_text(points[i]["setting"]) for i in clear)
    return f"is off the front ({names}: faster and more accurate beyond the spread)"


def _spread(point: Point) -> tuple[tuple[float, float], tuple[float, float]]:
    return (point["cpu_seconds"], point.get("cpu_seconds_sd", 0.0)), (point["error"], point["error_sd"])


def heading(points: Sequence[Point]) -> str:
    """What the points of a subject were measured on, in a sentence."""
    first, counts = points[0], sorted({point["repeats"] for point in points})
    machine = first["hardware"]
    seeds = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return (f"{spelled(first['workload'])}. Repetitions: {seeds}. Machine: {machine.get('processor')}, "
            f"{machine.get('cores')} cores.")  # fmt: skip
