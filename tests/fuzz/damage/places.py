"""What may stand in the place of a file: a FIFO, a device, a socket, links, a folder, a terabyte of holes.

Nothing here is opened, so that the harness cannot wait for its own FIFO. What was there is set aside, not copied, and
comes back as it was.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from sensor_model.files.door import VARIABLE, allow
from tests.fuzz.damage.tree import remove

TERABYTE = 1 << 40
DEVICES = {"zero": (1, 5), "null": (1, 3), "tty": (5, 0), "random": (1, 9)}

# What a reader may do with each. "same": it gives the result of the valid folder. "refused": it refuses, or goes on
# without the file, if it reads it at all. "any": whatever a damaged file may lead to.
RULE = {
    "FIFO": "any", "socket": "any", "device zero": "any", "device null": "any", "device tty": "any",
    "device random": "any", "link to itself": "any", "link loop": "any", "link to nothing": "any", "missing": "any",
    "folder for file": "any", "file for folder": "any", "FIFO for folder": "any", "sparse": "any",
    "link outside": "refused", "folder linked outside": "refused",
    "link outside, allowed": "same", "link inside": "same", "equal copy": "same",
}  # fmt: skip
OF_FOLDERS = ("file for folder", "FIFO for folder", "folder linked outside")


@contextmanager
def standing(kind: str, root: Path, name: str, outside: Path) -> Iterator[None]:
    """While this lasts, a thing of a kind stands in the place of the file `name` of `root`, or of its outermost folder.

    Args:
        kind: Of `RULE`.
        root: The folder that was given.
        name: Of the file in it.
        outside: A folder outside, for what is set aside and what links point to.
    """
    allowed = os.environ.get(VARIABLE)
    victim, aside = replace(kind, root, name, outside)
    try:
        yield
    finally:
        os.environ.pop(VARIABLE, None) if allowed is None else os.environ.__setitem__(VARIABLE, allowed)
        remove(victim)
        remove(hidden(victim))
        victim.parent.mkdir(parents=True, exist_ok=True)  # whoever read it may have removed more
        aside.rename(victim)


def replace(kind: str, root: Path, name: str, outside: Path, level: int = 1) -> tuple[Path, Path]:
    """Put it there for good; what was replaced, and where that lies now.

    Arguments as for `standing`; `level`: which of the folders that hold the file it is that is replaced.
    """
    victim = root.joinpath(*Path(name).parts[:level]) if kind in OF_FOLDERS else root / name
    aside = outside / "aside" / victim.name
    aside.parent.mkdir(parents=True, exist_ok=True)
    remove(aside)
    victim.rename(aside)
    put(kind, victim, aside, root, outside)
    return victim, aside


def fitting(kind: str, name: str, level: int = 1) -> str:
    """The kind itself, or what comes nearest where the file does not lie in so many folders."""
    if kind in OF_FOLDERS and name.count("/") < level:
        return {"folder linked outside": "link outside"}.get(kind, "folder for file")
    return kind


def put(kind: str, path: Path, aside: Path, root: Path, outside: Path) -> None:
    """Make a thing of a kind at a path where nothing is; `aside`: the valid file."""
    if kind.startswith("device"):
        path.symlink_to(device(kind.split()[1], outside))
        return
    if kind == "link outside, allowed":
        allow([aside.parent])
    _PUT[kind](path, aside, root, outside)


def hidden(path: Path) -> Path:
    """Where a link inside leads: beside it, for what a file names by relative paths; pictures must not become more."""
    return path.with_name(f".linked-{path.name}")


def device(name: str, outside: Path) -> Path:
    """A device of our own where we may make one: nobody is to lose /dev/null by what is tried here."""
    own = outside / f"device-{name}"
    if not own.exists():
        try:
            os.mknod(own, 0o666 | stat.S_IFCHR, os.makedev(*DEVICES[name]))
        except OSError:
            return Path("/dev") / name
    return own


def _inside(path: Path, aside: Path, root: Path, outside: Path) -> None:
    target = hidden(path)
    target.write_bytes(aside.read_bytes())
    path.symlink_to(target.name)


def _loop(path: Path, aside: Path, root: Path, outside: Path) -> None:
    other = outside / "loop"
    remove(other)
    other.symlink_to(path)
    path.symlink_to(other)


def _sparse(path: Path, aside: Path, root: Path, outside: Path) -> None:
    path.write_bytes(aside.read_bytes())
    os.truncate(path, TERABYTE)


def _folder(path: Path, aside: Path, root: Path, outside: Path) -> None:
    path.mkdir()
    (path / "a").write_bytes(b"x")


_PUT: dict[str, Callable[[Path, Path, Path, Path], object]] = {
    "FIFO": lambda path, *_: os.mkfifo(path),
    "FIFO for folder": lambda path, *_: os.mkfifo(path),
    "socket": lambda path, *_: os.mknod(path, 0o666 | stat.S_IFSOCK),
    "link to itself": lambda path, *_: path.symlink_to(path.name),
    "link loop": _loop,
    "link to nothing": lambda path, *_: path.symlink_to("nothing"),
    "link outside": lambda path, aside, *_: path.symlink_to(aside),
    "folder linked outside": lambda path, aside, *_: path.symlink_to(aside),
    "link outside, allowed": lambda path, aside, *_: path.symlink_to(aside),
    "link inside": _inside,
    "equal copy": lambda path, aside, *_: path.write_bytes(aside.read_bytes()),
    "missing": lambda *_: None,
    "folder for file": _folder,
    "file for folder": lambda path, *_: path.write_bytes(b"x"),
    "sparse": _sparse,
}
