"""Stages of a study that only write down what they were made from: a wrong table shows, and nothing is computed.

Workers load this by name. A file `faults` beside the store's folder names, one a line, what goes wrong: "KIND TEXT HOW"
for entries of that kind whose content holds the text.
"""

import errno
import hashlib
import os
import time
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.ledger import contents, stage
from novags.testbed.ledger.code import Code
from novags.testbed.ledger.stage import run_stage
from novags.testbed.study.entry import Order, StageStep, ensure
from sensor_model.files.atomic import write_text

stage.environment = dict  # type: ignore[assignment]  # the real one loads torch to look for a GPU
SIZE = 8000  # bytes; of the larger file of an entry


def make(order: Order, console: Console) -> dict[str, Any]:
    steps = {"write": StageStep(lambda: write(order, console), f"{order.task.kind}.json")}
    if order.task.kind == "run":
        steps["score"] = StageStep(lambda: score(order, console), "metrics.json", repeatable=True)
    if os.environ.get("CLOCK") == "backwards":
        now, start = time.time, time.time()
        time.time = lambda: 2 * start - now()  # type: ignore[assignment]
        time.time_ns = lambda: int(1e9 * time.time())  # type: ignore[assignment]
    return ensure(order, steps, console)


def content_of(kind: str, group: str, config: dict[str, Any], source: str) -> str:
    """What an entry holds; all that tells it from others."""
    if kind == "set":
        return f"scene {config['scene']}"
    if kind == "capture":
        return f"{source}, {config['electrons']:g} e-, seed {config['seed']}"
    return f"{source}, {group} {config['seed']}"


def value_of(content: str) -> float:
    """A score that no other content has."""
    return int(hashlib.sha256(content.encode()).hexdigest()[:6], 16) / 1e5


def write(order: Order, console: Console) -> None:
    task = order.task
    source = "" if order.source is None else (order.source / "content.txt").read_text()
    content = content_of(task.kind, task.group, task.config, source)

    def work(_: None) -> dict[str, Any]:
        with (order.folder.parent.parent.parent / "made").open("a") as made:
            made.write(f"{task.kind}: {content}\n")
        print(f"making {content}")
        write_text(order.folder / "large.txt", content * (SIZE // len(content)))
        for line in faults(order.folder):
            kind, text, how = line.split()
            if kind == task.kind and text in content:
                fail(how)
        write_text(order.folder / "content.txt", content)
        return {"threads": os.environ.get("OMP_NUM_THREADS")}

    run_stage(
        "write", order.folder, f"{task.kind}.json", code=Code({"key": task.code}, {}),
        inputs=lambda: {"source": contents.digest(source)}, config=task.config,
        owns=("large.txt", "content.txt"), prepare=lambda: None, work=work, console=console, overwrite=True,
    )  # fmt: skip


def score(order: Order, console: Console) -> None:
    content = (order.folder / "content.txt").read_text()
    value = value_of(content)
    mean = {"lit": {"psnr": value, "tone_aligned_psnr": value}, "enhanced": {"aligned_psnr": value}}
    scores = {"mean": mean, "views": {}, "training_2d": None, "seconds": {"fit": 1.0}, "peak_bytes": 1}
    run_stage(
        "score", order.folder, "metrics.json", code=Code({}, {}),
        inputs=lambda: {"content": contents.digest(content)}, config={}, owns=(),
        prepare=lambda: None, console=console, overwrite=True,
        work=lambda _: {"methods": {order.task.group: scores}, "recovered": {}, "unavailable": {}},
    )  # fmt: skip


def faults(entry: Path) -> list[str]:
    file = entry.parent.parent.parent / "faults"
    return file.read_text().splitlines() if file.exists() else []


def fail(how: str) -> None:
    if how == "full":
        with open("/dev/full", "w") as disk:
            disk.write("x")
    if how == "read-only":
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), "somewhere")
    if how.startswith("slow"):
        time.sleep(float(how[4:]))
    if how == "refused":
        raise ValueError("it does not suit me")
