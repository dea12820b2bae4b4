"""One entry of the store: kept if unchanged since it was sealed, else made by its stages, which resume unfinished work.

In a folder with plain names (`Task.place`) nothing tells one request from another but the files there: its stages look
themselves, and say which results they keep, which they make again and why.
"""

import os
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.ledger.code import code_of
from novags.testbed.ledger.contents import read_json
from novags.testbed.ledger.same import remember, sharing
from novags.testbed.ledger.store import SEAL, Seal, clear, damaged, read_seal, write_seal
from novags.testbed.stages.failing import failing_in
from novags.testbed.study.engines.worker import MachineError
from sensor_model.files.lock import locked
from simscenes.render.wavefront import MAX_WAVEFRONT

# Bytes of a view beside its pixels (tracks of its points), and of a pixel: measured on sets and captures of 8 to 50
# views of 48² to 1000² pixels, 53 to 63 and 28 to 36 bytes a pixel.
PICTURES = {"set": (1.3e5, 57.0), "capture": (1.3e5, 35.0), "mosaic": (1.3e5, 28.5)}


@dataclass(frozen=True)
class Task:
    """One entry of the store that has to be there."""

    kind: str  # "set", "capture", "run", which is scored too, or "measurement"
    key: str
    name: str  # of its folder
    config: Any  # of its stage: `RenderConfig`, `CaptureConfig`, `ImportConfig`, `ReconstructConfig`, …
    needs: tuple[str, ...] = ()  # keys of the tasks it is made from
    source: Path | None = None  # the set that a capture photographs, or the photographs it imports, if no task makes it
    group: str = ""  # the peers for its cost: the scene, the camera, the method; of KIN:… its kin, too
    work: float = 0.0  # the amount that its cost grows with, in `costs.UNITS`
    pixels: float = 0.0  # of all its views
    memory: float = 0.0  # bytes at the peak, by the figures of its method; 0: they grow with the pixels alone
    disk: float = 0.0  # bytes, by the number and the size of its pictures; 0: they grow with the pixels alone
    modules: tuple[str, ...] = ()  # `Source.modules` of the set that is photographed
    code: str = ""  # key of the code that is to make it
    roots: tuple[str, ...] = ()  # the modules that reach this code
    place: str = ""  # its folder, where names are plain; "": the store names it
    overwrite: bool = True  # whether finished results of another request are replaced; an entry of the store has one
    for_runs: bool = False  # whether methods read the capture: they need raw files that LibRaw reads
    stale: tuple[str, ...] = ()  # files beside its folder that describe it, removed when it is made again

    @property
    def title(self) -> str:
        """Its name for people."""
        return self.place or self.name.rpartition("-")[0]

    def folder(self, store: Path) -> Path:
        """Where it is, or will be."""
        return store / (self.place or f"{self.kind}/{self.name}")


@dataclass(frozen=True)
class Order:
    """The data of a task that a worker needs."""

    task: Task
    folder: Path  # of its entry
    source: Path | None  # folder that it is made from: of a set for a capture, of a capture for a run
    made_of: dict[str, str]  # content of each entry that it is made from, by key
    threads: int  # that this worker may use


@dataclass(frozen=True)
class StageStep:
    """A stage of an entry."""

    do: Callable[[], Any]  # does it, or nothing if it is done already
    record: str  # the file that it writes last
    repeatable: bool = False  # whether it can be done again alone, as the scores of a run can


Steps = dict[str, StageStep]  # by name, in order


def disk_of(kind: str, views: int, pixels: float, mosaic: bool = False) -> float:
    """Bytes of a rendered set or of a capture of one, see `PICTURES`; `pixels` of all its views."""
    view, pixel = PICTURES["mosaic" if mosaic else kind]
    return views * view + pixels * pixel


def peak_of(samples: float) -> float:
    """About the most memory that a set takes, bytes; `samples` of its largest view, which are traced at once up to a
    wavefront. Without any it is the memory of Python, Mitsuba and its compiler.
    """
    return 6e8 + 100.0 * min(samples, MAX_WAVEFRONT)


def ensure(order: Order, steps: Steps, console: Console, depends: dict[str, Any] | None = None) -> dict[str, Any]:
    """Make sure that an entry is there and complete.

    Args:
        order: The entry.
        steps: The steps that make it.
        console: Where notes go.
        depends: Further things that the content depends on; not in the key, because little of the work depends on it.

    Returns:
        `content`, `cost` and `made` (False: it was there) of the entry.

    Raises:
        ValueError: If a stage refuses its input.
        BlockingIOError: If another process is at work there.
        MachineError: If this process has other code than the process that planned the study, whose code the key is of.
    """
    if order.task.code and code_of(*order.task.roots).key != order.task.code:
        raise MachineError(
            f"novags on {os.uname().nodename} is another version than the planner of this study: it was changed "
            "meanwhile, or the nodes have different ones"
        )
    made_of = {**order.made_of, **(depends or {})}
    with locked(order.folder):
        plain = bool(order.task.place)
        seal = None if plain else _believed(order, steps, console)
        made = seal is None or seal.made_of != made_of
        if made:
            if not plain:
                (order.folder / SEAL).unlink(missing_ok=True)
            with nullcontext(list[str]()) if plain else sharing(order.folder.parent.parent) as taken:
                for name, step in steps.items():
                    with failing_in(name):
                        step.do()
            made = len(taken) < len(steps)
            records = [step.record for step in steps.values()]
            seal = write_seal(order.folder, order.task.key, made_of, _cost(order, steps), records)
            if not plain:
                remember(order.folder, records)
    assert seal is not None
    return {"content": seal.content, "cost": seal.cost, "made": made}


def _believed(order: Order, steps: Steps, console: Console) -> Seal | None:
    """The seal of a complete entry whose files have not changed; files that cannot be trusted are removed."""
    try:
        seal = read_seal(order.folder)
        if seal is None:
            return None
        wrong = damaged(order.folder, seal) if seal.key == order.task.key else [SEAL]
    except ValueError as error:
        console.note(f"{error}: making the entry again")
        clear(order.folder)
        return None
    if not wrong:
        return seal
    console.note(f"{order.folder}: {', '.join(wrong[:3])} not as written (checksum): making the entry again")
    if all(any(step.repeatable and step.record == name for step in steps.values()) for name in wrong):
        (order.folder / SEAL).unlink()
        for name in wrong:
            (order.folder / name).unlink(missing_ok=True)
    else:
        clear(order.folder)
    return None


def _cost(order: Order, steps: Steps) -> dict[str, Any]:
    task = order.task
    records = {name: read_json(order.folder / step.record) for name, step in steps.items()}
    # Of a run, a record's own peak belongs to a program which ran beside this process; of a set, to this process.
    beside = task.kind == "run"
    peaks = [
        int(record["stage"]["peak_bytes"]) + beside * int(record.get("peak_bytes", 0)) for record in records.values()
    ]
    return {
        "seconds": {name: float(record["stage"]["seconds"]) for name, record in records.items()},
        "peak_bytes": max(peaks),
        "group": task.group, "work": task.work, "pixels": task.pixels, "memory": task.memory, "disk": task.disk,
        "threads": order.threads,
    }  # fmt: skip
