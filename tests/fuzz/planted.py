"""Readers with a fault each, for the harness to find: `python -m tests.fuzz.planted` prints what it finds, as JSON."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from tests.fuzz.case import Cases, Reader
from tests.fuzz.damage.tree import Tree
from tests.fuzz.engine import run
from tests.fuzz.inside import Reading
from tests.fuzz.judge import Limits, jsonable

LIMITS = Limits(seconds=1.0, bytes=256 << 20)
calls: list[int] = []


def segfault() -> None:
    ctypes.string_at(0)


def abort() -> None:
    os.abort()


def leave() -> None:
    os._exit(0)


def hang() -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)
    while True:
        pass


def wait() -> None:
    time.sleep(60)


def one_large_block() -> None:
    bytearray(1 << 30)


def many_small_blocks() -> None:
    held = []
    while True:
        held.append(bytes(1 << 16))


def memory_behind_a_documented_error() -> None:
    try:
        bytearray(1 << 30)
    except MemoryError as error:
        raise ValueError("the file cannot be read") from error


def undocumented() -> None:
    raise KeyError("frames")


def recursion() -> None:
    recursion()


def stop() -> None:
    raise KeyboardInterrupt


def warning() -> None:
    warnings.warn("invalid value in matmul", RuntimeWarning, stacklevel=1)


def silence() -> None:
    raise ValueError("")


def flood() -> None:
    raise ValueError("x" * 10_000)


def only_after_others() -> None:
    calls.append(1)
    if len(calls) == 3:
        segfault()


def documented() -> None:
    calls.append(1)
    warnings.warn("2 views have no image", stacklevel=1)
    if len(calls) % 3 == 0:
        raise ValueError("w must be > 0, got 0")
    if len(calls) % 3 == 1:
        raise FileNotFoundError(2, "No such file", "a.png")


FAULTS: tuple[Callable[[], None], ...] = (
    segfault, abort, leave, hang, wait, one_large_block, many_small_blocks, memory_behind_a_documented_error,
    undocumented, recursion, stop, warning, silence, flood, only_after_others, documented,
)  # fmt: skip


def main() -> None:
    found = {}
    with tempfile.TemporaryDirectory() as temporary:
        for fault in FAULTS:
            folder = Path(temporary) / fault.__name__
            folder.mkdir()
            (folder / "a.txt").write_text("valid")
            # Only the second of three cases is at fault, except where one fault needs several calls.
            every = fault in (only_after_others, documented)

            def read(folder: Path, file: Path, fault: Callable[[], None] = fault, every: bool = every) -> None:
                if every or file.read_bytes() == b"2":
                    fault()

            reader = Reader(fault.__name__, lambda folder: None, read, ("a.txt",))
            whole = [("a.txt", str(k).encode()) for k in range(1, 4)]
            cases = Cases(reader, {"a.txt": b"valid"}, 0, whole, [], Tree.of(folder))
            found[fault.__name__] = [jsonable(f) for f in run(Reading(cases, LIMITS), range(3), folder)]
            assert (folder / "a.txt").read_text() == "valid" or found[fault.__name__]
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
