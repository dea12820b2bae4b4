"""Readers and commands that go wrong with odd files: `python -m tests.fuzz.planted_results` prints what is found."""

from __future__ import annotations

import ctypes
import json
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from sensor_model.files import door
from tests.fuzz.case import Case, Cases, Reader
from tests.fuzz.commands import doing
from tests.fuzz.commands.cases import MODULES, Deed
from tests.fuzz.commands.job import tried
from tests.fuzz.damage.tree import Tree
from tests.fuzz.engine import run
from tests.fuzz.inside import Reading
from tests.fuzz.judge import Limits, jsonable

VALID = b'{"w": 3, "h": 4}\n'
LIMITS = Limits(seconds=1.0, bytes=256 << 20)


def right(file: Path) -> object:
    """As a reader of the project."""
    text = door.read_text(file)
    return json.loads(text)


def anything(file: Path) -> object:
    """Opens whatever stands there."""
    return file.read_bytes()


def mark_read(file: Path) -> object:
    """Takes a byte-order mark for text."""
    return door.read_bytes(file).decode()


def order_kept(file: Path) -> object:
    """Lets the order of keys decide."""
    return list(json.loads(door.read_text(file)).values())


def no_links(file: Path) -> object:
    """Refuses every link."""
    if file.is_symlink():
        raise ValueError(f"{file} is a link")
    return right(file)


READERS: tuple[Callable[[Path], object], ...] = (right, anything, mark_read, order_kept, no_links)
KINDS = ("FIFO", "device zero", "sparse", "link outside", "link outside, allowed", "link inside", "equal copy",
         "link loop", "socket", "folder for file", "byte-order mark", "CRLF", "other order")  # fmt: skip


class Chosen(Cases):
    """Cases of one of each kind."""

    def case(self, k: int) -> Case:
        contents = {"byte-order mark": b"\xef\xbb\xbf" + VALID, "CRLF": VALID.replace(b"\n", b"\r\n"),
                    "other order": b'{"h": 4, "w": 3}\n'}  # fmt: skip
        return Case("a.json", contents.get(KINDS[k], b""), KINDS[k])


def readers(place: Path) -> dict[str, list[dict[str, object]]]:
    """What is found in each reader."""
    found = {}
    for read in READERS:
        folder = place / read.__name__
        folder.mkdir()
        (folder / "a.json").write_bytes(VALID)
        reader = Reader(read.__name__, lambda f: None, lambda f, p, read=read: read(p), ("a.json",))
        cases = Chosen(reader, {"a.json": VALID}, 0, [], [], Tree.of(folder))
        work = Reading(cases, LIMITS)
        found[read.__name__] = [jsonable(f) for f in run(work, range(len(KINDS)), folder)]
    return found


def _overwrite() -> None:
    Path("link").write_text("lost")


def _escape() -> None:
    print("\x1b[31mred")


def _shout() -> None:
    print("x" * 5000, file=sys.stderr)
    raise SystemExit(2)


def _warn() -> None:
    warnings.warn("invalid value in matmul", RuntimeWarning, stacklevel=1)


def _import_from_here() -> None:
    sys.path.insert(0, "")
    sys.modules.pop("mitsuba", None)
    __import__("mitsuba")


def _fail() -> None:
    raise KeyError("frames")


def _fill() -> None:
    bytearray(1 << 30)


COMMANDS: dict[str, Callable[[], object]] = {
    "overwrite": _overwrite, "escape": _escape, "shout": _shout, "warn": _warn, "execute": _import_from_here,
    "fail": _fail, "fill": _fill, "leave": lambda: sys.exit(7), "crash": lambda: ctypes.string_at(0),
    "wait": lambda: time.sleep(60), "new file": lambda: Path("../outside").write_text("x"),
    "silent": lambda: sys.exit(1), "right": lambda: print("done"), "refuse": lambda: Path("absent").read_bytes(),
    "end a link": lambda: sys.exit("refused" if Path("a").is_symlink() else 0),
}  # fmt: skip


def commands(place: Path) -> dict[str, tuple[str, str, str] | None]:
    """What is found in each command."""
    from novags import cli
    from novags.failure import errors_in_one_line

    world, found = place / "world", {}
    for name in ("world", "tmp"):
        (place / name).mkdir()
    os.environ["TMPDIR"] = str(place / "tmp")
    tempfile.tempdir = None
    assert "mitsuba" in MODULES
    for name, command in COMMANDS.items():

        def main(command: Callable[[], object] = command) -> None:
            with errors_in_one_line():
                command()

        cli.main = main
        kind = "link inside" if name == "end a link" else "equal copy"
        deed = Deed((), (Case("a", b"", kind),), (("link", "link to a file"),) * (name == "overwrite"), modules=True)
        found[name] = tried(deed, Tree({"a": b"a"}, ()), world, LIMITS)[0]
    return found


def main() -> None:
    doing.adopt()
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary).resolve()
        (place / "r").mkdir(), (place / "c").mkdir()
        json.dump({"readers": readers(place / "r"), "commands": commands(place / "c")}, sys.stdout)


if __name__ == "__main__":
    main()
