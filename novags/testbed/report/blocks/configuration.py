"""How to do it again: failures, differences from the published methods, commands, configurations, versions."""

import json
from collections import ChainMap
from typing import Any

from novags.testbed.report.material import Material, RunRecords
from novags.testbed.report.parts import Page, Table, TableRow, heads
from novags.testbed.report.rows import deviations
from novags.testbed.report.words import named
from novags.testbed.study.light import METHOD


def failed(material: Material, page: Page) -> dict[str, Any] | None:
    """The failed runs of a study, and scores that could not be computed, with the reasons."""
    rows = [row for row in material.rows if row["state"] in ("failed", "skipped")]
    reasons = {f"run {row['run']}, {row[METHOD]}{''.join(f', {axis} {row[axis]}' for axis in material.varied)}":
               f"{'a task it needs has failed: ' if row['state'] == 'skipped' else ''}"
               f"{row.get('reason') or 'no reason is known'}" for row in rows}  # fmt: skip
    skipped = any(row["state"] == "skipped" for row in rows)
    facts = {**reasons, **material.unavailable}
    return {"facts": facts, "runs": bool(rows), "skipped": skipped} if facts else None


def departures(material: Material, page: Page) -> dict[str, Any] | None:
    """Every setting in which a run differs from its method as published; of many places in the first run of each."""
    first: dict[str, RunRecords] = {}
    for each in material.made.values():
        first.setdefault(material.called(each), each)
    found, columns = list[dict[str, Any]](), heads("Setting | Published | Here")
    for name, each in first.items():
        if changed := deviations(each.run):
            look, rows = material.looks.get(name), [TableRow([d.setting, d.published, d.here]) for d in changed]
            table = Table(f"departures-{name}", f"Settings changed in {name}", columns, rows)
            found.append({"key": look.key if look else name, "name": named(look) if look else name,
                          "method": each.run.method, "count": len(changed), "table": table,
                          "open": material.one is not None and name == material.one.main})  # fmt: skip
    return {"found": found} if found else None


def configuration(material: Material, page: Page) -> dict[str, Any] | None:
    """The commands that do it again, every record's resolved configuration as indented JSON, and versions."""
    runs = list(material.made.values())
    lines = [command or f"# {material.made[number].name}: no command of this version makes the same configuration"
             for number, command in material.commands.items()]  # fmt: skip
    commands = [] if material.study else [material.command] if material.command else lines
    texts: dict[str, Any] = {"The study file": material.study[1]["table"]} if material.study else {}
    if place := material.one:
        if (made := place.lit.views.meta.get("stage")) is not None:
            texts[made.get("name", "render")] = made["config"]
        texts["import" if place.capture.imported else "capture"] = place.capture.record.stage["config"]
        texts |= {f"reconstruct: {name}": run.record["config"] for name, run in place.runs.items()}
    shown = {name: json.dumps(config, indent=2, ensure_ascii=not material.study) for name, config in texts.items()}
    versions = dict(ChainMap(*(each.run.record["stage"]["versions"] for each in runs)))  # of several: of the first
    return {"commands": commands, "texts": shown, "versions": versions}
