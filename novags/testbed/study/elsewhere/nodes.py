"""Entries whose store is at a URL: a node fetches missing inputs to a folder of its own, works there, and sends."""

import re
import secrets
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import METRICS
from novags.testbed.ledger.source import hashed
from novags.testbed.ledger.store import SEAL, Seal, read_seal
from novags.testbed.study.elsewhere.remote import FETCHED, Damaged, Remote
from novags.testbed.study.engines.worker import Outcome, function_at
from novags.testbed.study.entry import Order, Task
from novags.testbed.study.plan import StudyPlan
from novags.testbed.study.steps import depends
from sensor_model.files.atomic import atomic, write_text
from sensor_model.files.door import read_bytes, read_text
from sensor_model.files.lock import locked
from sensor_model.files.own import cache_folder, own_folder

PLACE = "novags.testbed.study.elsewhere.nodes:make"


@dataclass(frozen=True)
class Away:
    """An entry that a node has to make or find.

    Attributes:
        chain: The task, after all its inputs.
        threads: Of each of these.
        url: The store.
        scratch: Folder on each node that holds the folder of entries, see `scratch_folder`; None: that for temporary
            files.
        place: MODULE:FUNCTION that makes an entry from its `Order`.
    """

    chain: tuple[Task, ...]
    threads: tuple[int, ...]
    url: str
    scratch: str | None
    place: str


def make(away: Away, console: Console) -> dict[str, Any]:
    """Make sure that an entry is complete in the store; called on nodes. Returns as `entry.ensure`, and its scores."""
    scratch = scratch_folder(Path(away.scratch or tempfile.gettempdir()).expanduser())
    contents: dict[str, str] = {}
    for task, threads in zip(away.chain, away.threads, strict=True):
        made_of = {need: contents[need] for need in task.needs}
        source = away.chain[[t.key for t in away.chain].index(task.needs[0])].folder(scratch) if task.needs else None
        order = Order(task, task.folder(scratch), source, made_of, threads)
        result = _provide(order, Remote(away.url), away.place, console)
        contents[task.key] = result["content"]
    metrics = order.folder / METRICS
    return {**result, "scores": read_bytes(metrics) if metrics.exists() else None}


def scratch_folder(parent: Path) -> Path:
    """The folder of entries on this node, in a place that others may share; it may be deleted between studies.

    Entries in it are believed by their seals, so nobody else may have written them: it is this user's alone, and its
    name, which the user's cache folder knows, can neither be taken beforehand nor be in an archive that somebody made.

    Raises:
        OSError: If there can be no such folder.
    """
    try:
        known = own_folder(cache_folder("scratch")) / "name"
        if not known.exists():  # of two processes that are here at once, one works in a folder of its own once
            write_text(known, secrets.token_hex(8))
        name = read_text(known, most=100)
    except OSError as error:
        raise OSError(f"{error}: set XDG_CACHE_HOME to a folder of your own") from error
    if not re.fullmatch("[0-9a-f]{16}", name):
        raise OSError(f"{known} does not hold the name of a scratch folder: remove it")
    try:
        return own_folder(parent / f"novags-scratch-{name}")
    except OSError as error:
        raise OSError(f"{error}: give --scratch DIR, a place on the node's disk, or remove {known}, and another name "
                      "is taken") from error  # fmt: skip


def _provide(order: Order, remote: Remote, place: str, console: Console) -> dict[str, Any]:
    """An entry on this node and in the store: fetched, or made here and sent."""
    with locked(order.folder, wait=console.note):  # tasks beside each other need the same set
        there = _fetched(order, remote, console)
        result: dict[str, Any] = function_at(place)(order, console)
        seal = read_seal(order.folder)
        assert seal is not None
        if there is None or there.content != seal.content or there.made_of != seal.made_of:
            remote.send(order.task, order.folder, seal)
    return result


def _fetched(order: Order, remote: Remote, console: Console) -> Seal | None:
    """The seal of an entry that has been fetched; None if it is missing or cannot be trusted."""
    try:
        return remote.fetch(order.task, order.folder)
    except Damaged as error:
        console.note(f"{error}: making the entry again")
        return None


def known(plan: StudyPlan, remote: Remote, folder: Path) -> dict[str, Outcome]:
    """The complete entries of a study in its store; nothing but seals and scores is fetched.

    Args:
        plan: The study.
        remote: The store.
        folder: Where the seals and scores go, laid out as a store.

    Returns:
        The outcome of each entry whose seal is there and fits the seals of its inputs. Changes of its other files are
        noticed when they are needed.
    """
    names = {kind: remote.names(kind) for kind in {task.kind for task in plan.tasks.values()}}
    found: dict[str, Outcome] = {}
    for key, task in plan.tasks.items():  # each comes after the tasks it needs
        if task.name not in names[task.kind] or not all(need in found for need in task.needs):
            continue
        made_of = {**{need: found[need].said["content"] for need in task.needs}, **depends(task)}
        try:
            seal = remote.seal(task, task.folder(folder))
        except Damaged:
            continue  # said when it is made again
        if seal is None or seal.made_of != made_of:
            continue
        place = task.folder(folder)
        if METRICS in seal.records:
            scores = remote.read(task, METRICS) or b""
            if hashed(scores) != seal.records[METRICS]:
                continue
            keep_scores(place, scores)
        (place / FETCHED).replace(place / SEAL)
        found[key] = Outcome("done", {"content": seal.content, "cost": seal.cost, "made": False, "scores": None})
    return found


def keep_scores(folder: Path, scores: bytes) -> None:
    """Write the scores of a run whose other files are elsewhere."""
    with atomic(folder / METRICS) as temporary:
        temporary.write_bytes(scores)
