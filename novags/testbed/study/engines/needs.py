"""The needs of a task on a node of a cluster, and their form on the command line."""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from novags.testbed.ledger import store
from sensor_model.files.reading import brief

KINDS = tuple(kind for kind in store.KINDS if kind != "measurement")  # which are of this machine alone
MOST = 1e6  # of anything, in its unit
UNITS = {"": 1e9, "GB": 1e9, "MB": 1e6}  # a bare number means GB


@dataclass(frozen=True)
class Needs:
    """The needs of a task.

    Attributes:
        cpus: Cores, which are the threads that it uses.
        gpus: GPUs, or a part of one; with 0 it sees none.
        memory: Bytes; None: the prediction, with a margin.
    """

    cpus: int = 1
    gpus: float = 0.0
    memory: float | None = None


def read_needs(texts: Iterable[str]) -> dict[str, Needs]:
    """The needs of each kind of task, from words like `run:cpus=2,gpus=0.5,memory=8GB` or `cpus=2` for all kinds.

    Raises:
        ValueError: If a word is not of that form, or a number is out of range.
    """
    found = dict.fromkeys(KINDS, Needs())
    for text in texts:
        kind, colon, listed = text.rpartition(":")
        if colon and kind not in KINDS:
            raise ValueError(
                f"needs: there are no tasks {brief(repr(kind), 60)} in {brief(repr(text), 60)}; "
                f"there are {', '.join(KINDS)}"
            )
        changes: dict[str, Any] = dict(_amount(part, text) for part in listed.split(","))
        for name in (kind,) if colon else KINDS:
            found[name] = replace(found[name], **changes)
    return found


def _amount(part: str, text: str) -> tuple[str, float]:
    match = re.fullmatch(r"(cpus|gpus|memory)=(\d+(?:\.\d+)?)(GB|MB|)", part.strip())
    if match is None or (match[1] != "memory" and match[3]):
        raise ValueError(
            f"needs: {brief(repr(part), 60)} in {brief(repr(text), 60)} must be cpus=N, gpus=N, or memory=N "
            "with GB or MB"
        )
    name, number = match[1], float(match[2])
    if number > MOST:
        raise ValueError(
            f"needs: {name} must be at most {MOST:g}, got {brief(match[2], 40)} in {brief(repr(text), 60)}"
        )
    if name == "memory":
        return name, number * UNITS[match[3]]
    if name == "cpus" and (number < 1 or number % 1):
        raise ValueError(f"needs: cpus must be a whole number >= 1, got {match[2]} in {text!r}")
    if name == "gpus" and number > 1 and number % 1:
        raise ValueError(f"needs: gpus must be a whole number or below 1, got {match[2]} in {text!r}")
    return name, int(number) if name == "cpus" else number


def fits(asked: Mapping[str, float], node: Mapping[str, float]) -> bool:
    """Whether an idle node has the resources that a task asks for; both as Ray calls them."""
    return all(node.get(name, 0.0) >= amount for name, amount in asked.items())


def resources(needs: Needs) -> dict[str, float]:
    """The stated needs of a task, as Ray calls resources; memory only if it was stated."""
    asked = {"CPU": float(needs.cpus), "GPU": needs.gpus}
    return asked if needs.memory is None else {**asked, "memory": float(math.ceil(needs.memory))}
