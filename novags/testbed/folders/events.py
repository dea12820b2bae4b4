"""events.jsonl: the losses of a run, one line per step, on disk at once."""

import json
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from novags.numbers import FLOAT, STEPS, check_range
from novags.testbed.folders.shapes import MEASURED
from novags.testbed.ledger.contents import jsonable
from sensor_model.files.atomic import appending, write_text
from sensor_model.files.door import read_bytes
from sensor_model.files.records import check_shape, parse_json

AGAIN = "reconstruct again"
LOSS = {"iteration": float, "photometric": MEASURED}


class EventLog:
    """Appends events to a file; a killed process loses at most the event that it was writing.

    A run that goes on from a checkpoint repeats the steps after it: its first step replaces the lines from there on, so
    that the file in the end equals the file of an undisturbed run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BinaryIO | None = None

    def __enter__(self) -> "EventLog":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._file is not None:
            self._file.close()
        elif kind is None:  # nothing was left to do: only whole lines stay
            self._keep(None)

    def add(self, event: dict[str, Any]) -> None:
        """Append one event, {"step": ..., ...}; steps must grow."""
        if self._file is None:
            self._keep(event["step"])
            self._file = appending(self.path)
        self._file.write(f"{json.dumps(jsonable(event))}\n".encode())
        self._file.flush()  # before the checkpoint of this step is written: the log never lacks a step that a run skips

    def _keep(self, before: int | None) -> None:
        """Drop the steps from `before` on, and a line that was cut off."""
        lines = read_bytes(self.path).decode("utf-8", "replace").splitlines() if self.path.exists() else []
        steps = [(line, _step(line)) for line in lines]
        kept = [line for line, step in steps if step is not None and (before is None or step < before)]
        write_text(self.path, "".join(f"{line}\n" for line in kept))


def event_of(line: str, where: str) -> dict[str, Any]:
    """The event in a line of a finished log.

    Raises:
        ValueError: If it is damaged; begins with `where`.
    """
    event: dict[str, Any] = parse_json(line, where, AGAIN)
    check_shape(event, LOSS if isinstance(event, dict) and "photometric" in event else dict, where, AGAIN)
    if "photometric" in event:
        check_range(f"{where}: iteration", event["iteration"], 0, STEPS)
        if not isinstance(event["photometric"], str):
            check_range(f"{where}: photometric", event["photometric"] or 0, -FLOAT, FLOAT)
    return event


def _step(line: str) -> int | None:
    try:
        return int(parse_json(line, "a line")["step"])
    except (ValueError, KeyError, TypeError, OverflowError):  # edited by hand, or damaged
        return None
