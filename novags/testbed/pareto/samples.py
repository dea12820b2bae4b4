"""The measurements of a subject on disk: written after every one, so that an interruption costs at most that one."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from novags.testbed.console.provenance import environment
from novags.testbed.ledger.code import version
from novags.testbed.ledger.contents import digest, jsonable, read_json, write_json
from novags.testbed.pareto.knob import Knob, Measured, Setting, Subject, spelled
from sensor_model.files.reading import brief

NUMBER = (str, float, None)  # a setting
LARGEST = 1e100  # of a time or an error: their squares must be numbers too
OF = {"workload": "workload", "hardware": "hardware", "versions": "version of the software"}  # must all be the same
SHAPE = {
    **dict.fromkeys(OF, dict),
    "samples": [{"knob": str, "setting": NUMBER, "seed": int, "seconds": float, "cpu_seconds": float, "error": float,
                 "parts": {"*": float}, "spent": float}],
}  # fmt: skip


class Samples:
    """What was measured of a subject so far.

    Args:
        path: The file.
        subject: Whose.
        overwrite: Drop what the file holds if it was measured on other work, another machine or by other software.

    Raises:
        ValueError: If the file is damaged, or was measured on other work, another machine or by other software.
    """

    def __init__(self, path: Path, subject: Subject, *, overwrite: bool = False) -> None:
        self.path = path
        hardware = environment()["hardware"]
        self.about = jsonable({"workload": subject.workload, "hardware": hardware, "versions": software()})
        self.rows: list[dict[str, Any]] = []
        self.dropped = ""  # why what the file holds is
        if not path.exists():
            return
        known = read_json(path, SHAPE)
        other = [word for word in OF if known[word] != self.about[word]]
        if not other:
            self.rows = _checked(known["samples"], path)
            return
        before = brief("; ".join(spelled(_unlike(known[word], self.about[word])) for word in other), 400)
        self.dropped = f"{path} holds measurements of another {' and '.join(OF[word] for word in other)} ({before})"
        if not overwrite:
            raise ValueError(f"{self.dropped}: choose another --out, or add --overwrite to drop them")

    def find(self, knob: Knob, setting: Setting, seed: int) -> dict[str, Any] | None:
        """A measurement, or None if it was not made yet."""
        wanted = knob.key(setting, seed)
        return next((row for row in self.rows if (row["knob"], row["setting"], row["seed"]) == wanted), None)

    def of(self, knob: Knob, setting: Setting) -> dict[int, dict[str, Any]]:
        """All measurements of a setting, by seed."""
        keys = {row["seed"] for row in self.rows}
        return {seed: row for seed in sorted(keys) if (row := self.find(knob, setting, seed)) is not None}

    def add(self, knob: Knob, setting: Setting, seed: int, measured: Measured, spent: float) -> None:
        """Take in a measurement that took `spent` seconds with all its preparations, and write the file."""
        name, value, _ = knob.key(setting, seed)
        row = {"knob": name, "setting": value, "seed": seed, **jsonable(asdict(measured)), "spent": spent}
        self.rows.append(row)
        write_json(self.path, {**self.about, "samples": self.rows})

    def spent(self) -> Iterator[tuple[str, Setting, float]]:
        """Knob, setting and seconds of every measurement."""
        return ((row["knob"], row["setting"], row["spent"]) for row in self.rows)


def software() -> dict[str, str]:
    """Versions of the packages, and of the code itself: the number of novags stays while its code changes."""
    return {**environment()["versions"], "code": version()}


def work_folder(out: Path) -> Path:
    """Where measurements keep what they have in common: sets and truths. Other software makes its own."""
    return out / "work" / digest(software())[:16]


def _unlike(before: dict[str, Any], here: dict[str, Any]) -> dict[str, Any]:
    """What differs, as it was."""
    return {name: before.get(name) for name in {**before, **here} if before.get(name) != here.get(name)}


def _checked(rows: list[dict[str, Any]], path: Path) -> list[dict[str, Any]]:
    """The rows, all of whose times and errors are possible."""
    for place, row in enumerate(rows):
        for name in ("seconds", "cpu_seconds", "error"):
            if not 0 <= row[name] <= LARGEST:
                raise ValueError(f"{path}: samples[{place}].{name} must be in 0..{LARGEST:g}, got {row[name]:g}; "
                                 "remove the file to measure again")  # fmt: skip
    return rows
