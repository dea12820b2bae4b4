"""Stages that compute nothing, for tests of what runs them. Loaded by name in worker processes; nothing heavy."""

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.ledger import contents, stage
from novags.testbed.ledger.code import Code
from novags.testbed.study.entry import Order, StageStep, Task, ensure
from sensor_model.files.atomic import write_text

stage.environment = dict  # type: ignore[assignment]  # the real one loads torch to look for a GPU
PIECES = 4


@dataclass(frozen=True)
class Made:
    """What a stage is told to do."""

    text: str
    fails: str = ""  # how
    seconds: float = 0.0


def make(order: Order, console: Console) -> dict[str, Any]:
    return ensure(order, {"write": StageStep(lambda: write(order, console), "made.json")}, console)


def write(order: Order, console: Console) -> None:
    config: Made = order.task.config
    source = "" if order.source is None else "".join(piece(order.source, k).read_text() for k in range(PIECES))
    stage.run_stage(
        "write", order.folder, "made.json", code=Code({}, {}),
        inputs=lambda: {"source": contents.digest(source)}, config={"text": config.text},
        owns=("made.json", *(f"{k}.txt" for k in range(PIECES))), prepare=lambda: None, console=console,
        work=lambda _: write_pieces(order, source, console),
    )  # fmt: skip


def write_pieces(order: Order, source: str, console: Console) -> dict[str, Any]:
    config: Made = order.task.config
    print(f"making {config.text}")
    with (order.folder.parent / f".{config.text}.count").open("a") as count:
        count.write("x")
    (order.folder.parent / f".{config.text}.process").write_text(str(os.getpid()))
    with console.progress("write") as progress:
        for k in range(PIECES):
            time.sleep(config.seconds / PIECES)
            write_text(piece(order.folder, k), f"{config.text}{k}({source})")
            progress(k + 1, PIECES, "")
    if config.fails:
        FAILURES[config.fails](order)
    return {"threads": os.environ.get("OMP_NUM_THREADS"), "gpus": os.environ.get("CUDA_VISIBLE_DEVICES")}


def piece(folder: Path, k: int) -> Path:
    return folder / f"{k}.txt"


def refused(order: Order) -> None:
    raise ValueError("it does not\nsuit me")


def full(order: Order) -> None:
    raise OSError(28, "No space left on device", str(order.folder / "x"))


def full_said_in_words(order: Order) -> None:
    raise OSError(f"cannot write {order.folder / 'x.exr'}: Failed to write pixel data. No space left on device.")


def crashed(order: Order) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def unforeseen(order: Order) -> None:
    raise KeyError("what")


def left(order: Order) -> None:
    sys.stderr.flush()
    os._exit(3)


def first_time(order: Order) -> None:
    """Fail unless a file says that all is well now."""
    if not (order.folder.parent / "mended").exists():
        raise RuntimeError("not yet")


def killed_once(order: Order) -> None:
    killed(order, os.getpid(), 1)


def parent_killed_once(order: Order) -> None:
    """On a node of a cluster, the Ray worker."""
    killed(order, os.getppid(), 1)
    time.sleep(30)


def killed_always(order: Order) -> None:
    killed(order, os.getpid(), 9)


def killed(order: Order, process: int, times: int) -> None:
    """Make a mark, then end a process, unless there are so many marks."""
    marks = order.folder.parent / f".{order.task.key}.killed"
    if not marks.exists() or len(marks.read_text()) < times:
        with marks.open("a") as file:
            file.write("x")
        os.kill(process, signal.SIGKILL)


def too_large(order: Order) -> None:
    raise MemoryError("reconstruct: memory is not enough")


FAILURES = {f.__name__: f for f in (refused, full, full_said_in_words, crashed, unforeseen, left,
                                   first_time, too_large, killed_once, parent_killed_once, killed_always)}  # fmt: skip


def task(text: str, *needs: str, **config: Any) -> Task:
    return Task(kind="run", key=text, name=text, config=Made(text, **config), needs=needs)
