"""The entries of a store, and which of them nobody refers to any more.

Keys depend on code: after a change the entries of before stay, and no study asks for them. A study refers to its runs,
and an entry to the entries that it was made from.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from novags.testbed.ledger.contents import UNFINISHED
from novags.testbed.ledger.store import KINDS, clear, read_seal
from sensor_model.files.atomic import remove
from sensor_model.files.lock import locked

KEY = 16  # characters of a key at the end of the name of an entry


@dataclass(frozen=True)
class StoreEntry:
    """One folder of a store.

    Attributes:
        kind: One of `KINDS`.
        folder: Where it is.
        size: Bytes of all its files.
        needs: Ends of the names of its inputs.
        complete: Whether it is finished.
    """

    kind: str
    folder: Path
    size: int
    needs: frozenset[str]
    complete: bool

    @property
    def end(self) -> str:
        """Of its name: the beginning of its key."""
        return self.folder.name.rpartition("-")[2]


def entries(store: Path) -> Iterator[StoreEntry]:
    """The entries of a store; damaged seals count as unfinished work.

    Raises:
        ValueError: If the folder is no store.
    """
    if not any((store / kind).is_dir() for kind in KINDS):
        raise ValueError(f"{store} is no store: it has none of the folders {', '.join(KINDS)}")
    for kind in KINDS:
        for folder in sorted((store / kind).glob("[!.]*-*")):
            if not folder.is_dir() or folder.is_symlink():
                continue
            try:
                seal = read_seal(folder)
            except ValueError:
                seal = None
            files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
            needs = frozenset(key[:KEY] for key in seal.made_of) if seal else frozenset[str]()
            yield StoreEntry(kind, folder, sum(path.stat().st_size for path in files), needs, seal is not None)


def unreferenced(found: Iterable[StoreEntry], ends: Iterable[str]) -> list[StoreEntry]:
    """The entries that neither have these ends of names nor are inputs of such entries."""
    by_end = {entry.end: entry for entry in found}
    waiting, kept = list(ends), set[str]()
    while waiting:
        end = waiting.pop()
        if end in by_end and end not in kept:
            kept.add(end)
            waiting += by_end[end].needs
    return [entry for end, entry in by_end.items() if end not in kept]


def drop(entry: StoreEntry) -> None:
    """Remove an entry.

    Raises:
        BlockingIOError: If another process is at work on it.
    """
    with locked(entry.folder):
        clear(entry.folder)
        (entry.folder / UNFINISHED).unlink(missing_ok=True)
    remove(entry.folder)
