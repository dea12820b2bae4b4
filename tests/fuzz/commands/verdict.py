"""Whether a command may end as it did."""

from __future__ import annotations

import hashlib
import os
import re
import signal
import stat
from pathlib import Path

from tests.fuzz.commands.doing import Ended
from tests.fuzz.judge import LONGEST, MEMORY, Limits, places_in

CODES = (0, 1, 2, 130, 141)
WARNING = re.compile(r"^[^\n:]*:\d+: \w*Warning: .*$|^\w*Warning: .*$", re.MULTILINE)  # a path may hold spaces
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
SLACK = 300  # characters of a message that are not the file's: what it is about, and what to do


def seen(folder: Path) -> dict[str, tuple[object, ...]]:
    """What lies in a folder, so that a change is noticed."""
    found: dict[str, tuple[object, ...]] = {}
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = Path(place, name)
            state = path.lstat()
            entry: tuple[object, ...] = (state.st_mode, state.st_mtime_ns, state.st_ino)
            if stat.S_ISREG(state.st_mode) and state.st_size < 1 << 24:
                entry = (*entry, hashlib.sha256(path.read_bytes()).hexdigest())
            found[path.relative_to(folder).as_posix()] = entry
    return found


def verdict(ended: Ended, limits: Limits) -> tuple[str, str, str] | None:
    """Kind, detail and place of what a command did wrong; None if it did as documented."""
    said = [line for line in ended.err.splitlines() if line.strip()]
    last = said[-1] if said else ""
    own = places_in(ended.trace or ended.err)
    if ended.code is None:
        stack = places_in(ended.stack)
        return "hang", f"not finished after {3 * limits.seconds:g} s", stack[0] if stack else ""
    if ended.code < 0:
        stack = places_in(ended.stack)
        return "crash", signal.Signals(-ended.code).name, stack[0] if stack else ""
    if any(words in ended.err for words in (*MEMORY, "MemoryError", "out of memory")):
        return "memory", last[:300], own[-1] if own else ""
    if "Traceback (most recent call last)" in ended.err or "please report it" in ended.err:
        return "exception", last[:300], own[-1] if own else ""
    if ended.code not in CODES[:3]:
        return "exit", f"exit code {ended.code}: {last[:200]}", ""
    return _printed(ended, last)


def _printed(ended: Ended, last: str) -> tuple[str, str, str] | None:
    """What is wrong with what it printed."""
    if found := WARNING.search(ended.err):
        return "warning", found[0][-300:], ""
    for name, text in (("output", ended.out), ("error", ended.err)):
        if found := CONTROL.search(text):
            around = text[max(0, found.start() - 60) : found.end() + 20]
            return "control", f"{found[0]!r} on standard {name}: {around!r}", ""
    longest = max(map(len, ended.err.splitlines()), default=0)
    if longest > LONGEST + SLACK:
        return "message", f"{longest} characters in one line: {last[:80]!r}", ""
    if ended.code and not last:
        return "message", f"exit code {ended.code} without a word", ""
    return None
