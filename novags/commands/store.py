"""`novags store`: the size of a store of studies, and the entries that can go."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from novags.commands import shared
from novags.commands.shared import say, typed
from novags.options import Folder, Folders

if TYPE_CHECKING:
    from novags.testbed.ledger.pruning import StoreEntry


def store(
    action: Annotated[Literal["size", "prune"], tyro.conf.Positional], folder: Folder, refer: Folders = (), *,
    dry_run: bool = False,
) -> None:  # fmt: skip
    """Show the size of a store of studies, or remove entries that no study refers to.

    After a change of code a study makes its entries again, and the old ones stay: nothing asks for them any more.

    Args:
        action: size, or prune.
        folder: The store.
        refer: Of prune: the studies whose entries stay: their folders (--out), or their files, whose entries of now
            stay. All that these were made from stays too.
        dry_run: Only name the entries to remove.
    """
    from novags.testbed.ledger.pruning import entries, unreferenced
    from novags.testbed.ledger.store import KINDS

    if action == "size" and (refer or dry_run):
        raise ValueError("studies and --dry-run belong to prune: size removes nothing")
    if action == "prune" and not refer:
        raise ValueError(f"prune needs the studies whose entries stay: novags store prune {typed(folder)} STUDY...")
    found = list(entries(folder))
    if action == "size":
        for kind in KINDS:
            say(f"{kind}: {_counted([entry for entry in found if entry.kind == kind])}")
        say(f"all: {_counted(found)}")
        return
    ends = {end for place in refer for end in _ends(place, folder)}
    _prune(unreferenced(found, ends), len(found), dry_run)


def _prune(dead: "list[StoreEntry]", count: int, dry_run: bool) -> None:
    from novags.testbed.ledger.pruning import drop

    busy = list[Path]()
    for entry in dead:
        say(entry.folder)
        if not dry_run:
            try:
                drop(entry)
            except BlockingIOError:
                busy.append(entry.folder)
    for folder in busy:
        say(f"{folder}: another process is at work there, kept")
    gone = [entry for entry in dead if entry.folder not in busy]
    say(f"{'would remove' if dry_run else 'removed'} {_counted(gone)} of {count}")


def _ends(place: Path, folder: Path) -> set[str]:
    """The ends of the names of the entries that a study refers to."""
    from novags.testbed.folders.runs import STUDY
    from novags.testbed.ledger.contents import read_json
    from novags.testbed.ledger.pruning import KEY
    from novags.testbed.study.curves.measuring import read_any
    from novags.testbed.study.plan import plan_of
    from novags.testbed.study.session import SHAPE

    if place.is_dir():
        return {run["key"][:KEY] for run in read_json(place / STUDY, SHAPE)["runs"]}
    return {key[:KEY] for key in plan_of(read_any(place), folder, shared.console(), here=False).tasks}


def _counted(found: "list[StoreEntry]") -> str:
    unfinished = sum(not entry.complete for entry in found)
    size = sum(entry.size for entry in found) / 1e6
    return f"{len(found)} entries, {size:,.1f} MB" + (f" ({unfinished} unfinished)" if unfinished else "")
