"""events.jsonl: the losses of a run, one line per step, on disk as soon as they are known."""

import json
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from novags.testbed.cache import jsonable
from sensor_model.files.atomic import write_text


class EventLog:
    """Appends events to a file; a killed process loses none but the one it was writing.

    A run that goes on from a checkpoint repeats the steps after it: its first step replaces what the file holds from
    there on, so that the file is in the end that of a run that was never stopped.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: TextIO | None = None

    def __enter__(self) -> "EventLog":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._file is not None:
            self._file.close()
        elif kind is None:  # nothing was left to do: only what is whole stays
            self._keep(None)

    def add(self, event: dict[str, Any]) -> None:
        """Append one event, {"step": ..., ...}; steps must grow."""
        if self._file is None:
            self._keep(event["step"])
            self._file = self.path.open("a", encoding="utf-8")
        self._file.write(f"{json.dumps(jsonable(event))}\n")
        self._file.flush()  # before the checkpoint of this step is written: the log never lacks a step that a run skips

    def _keep(self, before: int | None) -> None:
        """Drop the steps from `before` on, and a line that was cut off."""
        lines = self.path.read_text(encoding="utf-8", errors="replace").splitlines() if self.path.exists() else []
        steps = [(line, _step(line)) for line in lines]
        kept = [line for line, step in steps if step is not None and (before is None or step < before)]
        write_text(self.path, "".join(f"{line}\n" for line in kept))


def _step(line: str) -> int | None:
    try:
        return int(json.loads(line)["step"])
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):  # edited by hand, or damaged
        return None
