"""What the folders of a study's runs state: commands, costs of shared stages, what was simulated, what differs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from novags.testbed.folders import capture as capture_folder
from novags.testbed.folders import shapes
from novags.testbed.folders.place import PLACE, place_of
from novags.testbed.folders.run import Run, open_run
from novags.testbed.ledger.contents import read_json
from novags.testbed.report.rows import deviations
from novags.testbed.report.study.grid import Line, by_place
from novags.testbed.results.again import score_again
from novags.testbed.study.grid import spelled

RECORD = "set.json"
COST = {"seconds": float, "peak_bytes": int}
SET: Any = {"stage?": {"name?": str, **COST}, "plan?": (shapes.PLAN, None)}
CAPTURE: Any = {"stage": COST, "set?": ({"path": PLACE}, None), "plan?": (shapes.PLAN, None),
                "signal_quantiles_e?": {"*": shapes.MEASURED}, "sensor_name?": (str, None)}  # fmt: skip
SHARES = {"0.01": "1 % get less", "0.25": "a quarter", "0.5": "half", "0.75": "three quarters", "0.99": "99 %"}
PLANS = {"set": "Light transport", "capture": "Sensor"}


@dataclass
class Records:
    """The records of the runs that are on this machine.

    Attributes:
        folder: Of the study.
        runs: By number of the row.
        captures: Folder and capture.json by number of the row.
        sets: Folder and set.json (None where it is missing) by number of the row.
        lost: Numbers of finished rows whose folder is not here, or cannot be read.
    """

    folder: Path
    runs: dict[int, Run] = field(default_factory=dict)
    captures: dict[int, tuple[Path, dict[str, Any]]] = field(default_factory=dict)
    sets: dict[int, tuple[Path, dict[str, Any] | None]] = field(default_factory=dict)
    lost: list[int] = field(default_factory=list)

    def commands(self, page: Path) -> dict[int, str]:
        """The command that makes each run again, in the folder of the page; runs without one are missing."""
        found = {number: score_again(run, page.parent, f"{run.name}-{number}") for number, run in self.runs.items()}
        return {number: command for number, command in found.items() if command is not None}

    def costs(self) -> list[dict[str, Any]]:
        """Count, seconds in all and each, and peak memory of the stages; shared ones count once."""
        made: dict[str, dict[Path, dict[str, Any]]] = {}
        for path, facts in self.sets.values():
            if facts is not None and facts.get("stage"):
                made.setdefault(facts["stage"].get("name", "render"), {})[path] = facts["stage"]
        for path, facts in self.captures.values():
            made.setdefault("capture", {})[path] = facts["stage"]
        for run in self.runs.values():
            spent = {**run.record["stage"], "peak_bytes": run.peak_bytes}
            made.setdefault(f"reconstruct: {run.name}", {})[run.path] = spent
        return [
            {"label": label, "count": len(stages), "seconds": sum(stage["seconds"] for stage in stages.values()),
             "each": sum(stage["seconds"] for stage in stages.values()) / len(stages),
             "peak": max(stage["peak_bytes"] for stage in stages.values())}
            for label, stages in made.items()
        ]  # fmt: skip

    def effects(self) -> dict[str, list[dict[str, Any]]]:
        """For each kind of plan: how often each effect was simulated, and what leaving it out cost at most."""
        plans = {"set": {path: facts.get("plan") for path, facts in self.sets.values() if facts},
                 "capture": {path: facts.get("plan") for path, facts in self.captures.values()}}  # fmt: skip
        return {PLANS[kind]: _effects([plan for plan in found.values() if plan]) for kind, found in plans.items()
                if any(found.values())}  # fmt: skip

    def departures(self) -> dict[str, list[Any]]:
        """The settings in which the first finished run of each method differs from the method as published."""
        first: dict[str, Run] = {}
        for run in self.runs.values():
            first.setdefault(run.name, run)
        return {name: found for name, run in first.items() if (found := deviations(run))}


def signals(lines: Sequence[Line], records: Records) -> list[dict[str, Any]]:
    """How much light the pixels of each place get, in electrons; places without a record are missing."""
    found = []
    for members in by_place(lines).values():
        numbers = [int(row["run"]) for line in members for row in line.runs if int(row["run"]) in records.captures]
        facts = records.captures[numbers[0]][1] if numbers else {}
        if quantiles := facts.get("signal_quantiles_e"):
            shown = {name: quantiles[key] for key, name in SHARES.items() if key in quantiles}
            found.append({"place": spelled(members[0].place) or "all runs", "camera": facts.get("sensor_name") or "",
                          "electrons": shown})  # fmt: skip
    return found


def read_records(folder: Path, rows: Sequence[Mapping[str, Any]]) -> Records:
    """Read the records of every finished run whose folder is here; one that cannot be read is among the lost."""
    found, known = Records(folder), dict[Path, Any]()
    for row in rows:
        if row["state"] != "done":
            continue
        number = int(row["run"])
        path = folder / str(row.get("folder"))
        try:
            run = open_run(path)
            capture = place_of(path, run.record["capture"])
            if capture not in known:
                known[capture] = read_json(capture / capture_folder.RECORD, CAPTURE)
            made_of = place_of(capture, (known[capture].get("set") or {}).get("path", "."))
            if made_of not in known:
                known[made_of] = read_json(made_of / RECORD, SET) if (made_of / RECORD).is_file() else None
        except (ValueError, OSError):
            found.lost.append(number)
            continue
        found.runs[number] = run
        found.captures[number] = (capture, known[capture])
        found.sets[number] = (made_of, known[made_of])
    return found


def _effects(plans: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    rows: dict[str, dict[str, Any]] = {}
    for plan in plans:
        for effect in plan["effects"]:
            fresh = {"on": 0, "of": 0, "left_out": None, "bound": None, "unit": effect["unit"]}
            row = rows.setdefault(effect["name"], {"name": effect["name"].replace("_", " "), **fresh})
            row["of"] += 1
            row["on"] += effect["on"]
            for key, value in (("left_out", effect["contribution"]), ("bound", effect["bound"])):
                if not effect["on"] and isinstance(value, float | int):
                    row[key] = value if row[key] is None else max(row[key], value)
    return [row for row in rows.values() if row["on"] or row["left_out"]]
