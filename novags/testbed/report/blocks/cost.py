"""The cost: time and memory of every stage, and the machine."""

from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import Any

from markupsafe import Markup

from novags.testbed.console.provenance import PACKAGES
from novags.testbed.console.speed import WIDTHS
from novags.testbed.folders.run import METRICS, Run
from novags.testbed.ledger.contents import read_json
from novags.testbed.report.material import Material
from novags.testbed.report.parts import Column, Page, Table, TableCell, TableRow, heads, num
from novags.testbed.report.words import duration, size
from novags.testbed.study.light import METHOD

BAR = Markup('<span class="bar {}" style="width:{:.1f}%"></span><small class="muted">{}</small>')
WIDE = Markup(' class="wide" data-value="{}"')


def cost(material: Material, page: Page) -> dict[str, Any] | None:
    """The stages, the machine, and where runs were not made alike."""
    if not material.made:
        return None
    stages, rows = costs(material), list[TableRow]()
    several = any(row["count"] > 1 for row in stages)
    for row in stages:
        parts = ", ".join(f"{part} {duration(seconds)}" for part, seconds in row["parts"].items())
        bar = TableCell(BAR.format(row["look"], 100 * row["bar"], parts), WIDE.format(row["share"]))
        count, seconds = row["count"], row["seconds"]
        times = [num(count, 0), num(seconds, duration(seconds)), num(seconds / count, duration(seconds / count))]
        rows.append(
            TableRow([row["label"], *(times if several else times[1:2]), bar, num(row["peak"], size(row["peak"]))])
        )
    columns = heads("Stage | #Times done | #Time in all | #Time each" if several else "Stage | #Time")
    columns += [Column("Share", kind="wide"), Column("Peak memory", kind="num")]
    runs = {each.name: each.run for each in material.made.values()}
    main = runs[material.one.main] if material.one else next(iter(runs.values()))
    return {"table": Table("costs", "Time and memory of every stage", columns, rows), "mixed": mixed(runs),
            "shared": several, "hardware": main.record["stage"]["hardware"], "speed": speed(material)}  # fmt: skip


def costs(material: Material) -> list[dict[str, Any]]:
    """Count, seconds in all and peak memory of the stages, in order, with the parts of reconstructions.

    What runs share counts once. `share` is of the time of all stages, `bar` of the longest one's.
    """
    made: dict[str, dict[Path, Mapping[str, Any]]] = {}
    runs, looks = list(material.made.values()), dict[str, str]()
    for each in runs:
        if stage := each.rendered.get("stage"):
            made.setdefault(stage.get("name", "render"), {})[each.set] = stage
    for each in runs:
        label = "import" if each.captured.get("kind") == "imported" else "capture"
        made.setdefault(label, {})[each.capture] = each.captured["stage"]
    for each in runs:
        label, called = f"reconstruct: {material.called(each)}", material.called(each)
        looks[label] = material.looks[called].key if called in material.looks else ""
        spent = {**each.run.record["stage"], "peak_bytes": each.run.peak_bytes, "parts": each.run.record["seconds"]}
        made.setdefault(label, {})[each.run.path] = spent
    scores = () if material.study else (each.run.path / METRICS for each in runs)
    if scored := {path: stage for path in scores if path.exists() and (stage := read_json(path).get("stage"))}:
        made["score"] = scored
    found = [{"label": label, "look": looks.get(label, ""), "count": len(stages) if label != "score" else 1,
              "seconds": sum(stage["seconds"] for stage in stages.values()), "parts": _parts(stages),
              "peak": max(stage["peak_bytes"] for stage in stages.values())}
             for label, stages in made.items()]  # fmt: skip
    seconds = [row["seconds"] for row in found]
    whole, longest = sum(seconds) or 1.0, max(seconds, default=0.0) or 1.0
    return [{**row, "share": row["seconds"] / whole, "bar": row["seconds"] / longest} for row in found]


def speed(material: Material) -> Table | None:
    """How fast the Gaussians of each method are drawn: means over its runs, and what drew them."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in material.rows:
        if all(isinstance(row.get(f"frames_per_second.{width}"), int | float) for width in WIDTHS):
            found.setdefault(str(row[METHOD]), []).append(row)
    if not found:
        return None
    rows = [TableRow([name, *(num(rate, 1 if rate < 10 else 0) for width in WIDTHS
                              for rate in [fmean(row[f"frames_per_second.{width}"] for row in mine)]),
                      ", ".join(dict.fromkeys(map(_drawn_by, mine)))])
            for name, mine in found.items()]  # fmt: skip
    columns = heads(" | ".join(["Method", *(f"#{width} px wide [1/s]" for width in WIDTHS), "Drawn by"]))
    return Table("speed", "Pictures in a second", columns, rows)


def _drawn_by(row: Mapping[str, Any]) -> str:
    threads = row.get("frames_per_second.threads")
    return "GPU" if row.get("frames_per_second.device") == "cuda" else f"{threads} thread{'' if threads == 1 else 's'}"


def _parts(stages: Mapping[Path, Mapping[str, Any]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for stage in stages.values():
        for part, seconds in stage.get("parts", {}).items():
            found[part] = found.get(part, 0.0) + seconds
    return found


def mixed(runs: Mapping[str, Run]) -> str:
    """In words what differs between these runs: software, processor, graphics card; "" if nothing does.

    Keys of results leave these out: a fit that was made elsewhere is no other fit. The last bits differ, though, and
    scores with them: a comparison says so.
    """
    found: dict[str, dict[str, list[str]]] = {}
    for name, run in runs.items():
        stage = run.record["stage"]
        hardware = {"processor": stage["hardware"]["processor"], "GPU": stage["hardware"]["gpu"] or "none"}
        for what, value in {**stage["versions"], **hardware}.items():
            found.setdefault(what, {}).setdefault(str(value), []).append(name)
    for what, values in found.items():
        listed = {name for names in values.values() for name in names}
        # Records have packages with rows, and plugin files, only where one of their rows was used.
        if what in PACKAGES and (missing := [name for name in runs if name not in listed]):
            values["not installed"] = missing
    several = {what: values for what, values in found.items() if len(values) > 1}
    if not several:
        return ""
    told = "; ".join(
        f"{what} {', '.join(f'{value} ({_named(names)})' for value, names in values.items())}"
        for what, values in several.items()
    )
    return f"These runs were not made alike, so that small differences between them say little: {told}."


def _named(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
