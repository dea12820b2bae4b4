"""A program of somebody else: run without a shell, with its time, its memory and its output when it failed."""

import ctypes
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import IO

from sensor_model.files.reading import brief

LOOK = 0.2  # s between two looks at its memory
GRACE = 5.0  # s that it gets to end when it is told to
SHORT = 60.0  # s that a program gets to say its version
KEPT = 4000  # bytes of its last output that are kept for a reason
PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None  # loaded before the fork, after which little is allowed


@dataclass(frozen=True)
class Spent:
    """Time and memory of a program.

    Attributes:
        seconds: Wall time.
        peak_bytes: Most main memory that it and its children held at a time; 0 where the system does not tell.
    """

    seconds: float
    peak_bytes: int


@cache
def output_of(words: tuple[str, ...], folder: Path) -> str:
    """The output of a program that ends at once, asked once.

    Raises:
        ValueError: If it cannot be started, fails, takes longer than `SHORT` s, or prints nothing or more than `KEPT`
            bytes.
    """
    said = brief(" ".join(words), 100)
    try:
        done = subprocess.run(words, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, timeout=SHORT)  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ValueError(f"version: {said} gave no answer: {brief(error, 200)}") from error
    text = done.stdout.decode("utf-8", "replace").strip()
    if done.returncode:
        raise ValueError(f"version: {said} ended with exit code {done.returncode}: {brief(text, 200) or 'no message'}")
    if not text or len(done.stdout) > KEPT:
        raise ValueError(f"version: {said} must print 1 to {KEPT} bytes, got {len(done.stdout)}")
    return text


def run_program(words: Sequence[str], folder: Path, *, timeout: float | None, tick: Callable[[float], None]) -> Spent:
    """Run a program to its end. Its output goes to standard error of this process: in a study, to the log.

    It gets nothing on standard input. It ends, with its children, when this process is interrupted or killed, or the
    time is up.

    Args:
        words: The program and its arguments, verbatim: no shell looks at them.
        folder: Where it runs.
        timeout: Seconds after which it is ended; None: never.
        tick: Told the seconds so far, now and then.

    Raises:
        ValueError: If it cannot be started, fails, or takes too long; with its last line.
    """
    start = time.monotonic()
    try:
        process = subprocess.Popen(
            words, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True, preexec_fn=_end_with_parent if _LIBC is not None else None,
        )  # fmt: skip
    except OSError as error:
        raise ValueError(f"cannot start {words[0]}: {error.strerror or error}") from error
    assert process.stdout is not None
    heard = _Output(process.stdout)
    memory = _Memory(process.pid)
    try:
        while process.poll() is None:
            memory.look()
            tick(time.monotonic() - start)
            if timeout is not None and time.monotonic() - start > timeout:
                raise ValueError(f"{words[0]} was ended after its timeout of {timeout:g} s{heard.last_line()}")
            with suppress(subprocess.TimeoutExpired):
                process.wait(LOOK)
    finally:
        _end(process)
        heard.close()
    if process.returncode != 0:
        raise ValueError(f"{words[0]} {_how(process.returncode)}{heard.last_line()}")
    return Spent(time.monotonic() - start, memory.peak)


def _end_with_parent() -> None:
    assert _LIBC is not None
    _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a program and all processes it has started; without effect on one that has ended, but for processes it left
    behind.
    """
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(OSError):  # nobody is left
            os.killpg(process.pid, number)
        try:
            process.wait(GRACE)
        except subprocess.TimeoutExpired:
            continue
    process.wait()


def _how(code: int) -> str:
    if code >= 0:
        return f"ended with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    return f"was ended by {name}" + (", as the system does when memory runs out" if name == "SIGKILL" else "")


class _Output:
    """Passes on the output of a program, and keeps the end of it."""

    def __init__(self, stream: IO[bytes]) -> None:
        self.kept = b""
        self.stream = stream
        self.thread = threading.Thread(target=self._pump, daemon=True)
        self.thread.start()

    def _pump(self) -> None:
        while chunk := os.read(self.stream.fileno(), 1 << 16):
            self.kept = (self.kept + chunk)[-KEPT:]
            with suppress(OSError):  # a full disk must not stop the program with a full pipe
                os.write(2, chunk)

    def last_line(self) -> str:
        """The last line that says something, for the end of a message."""
        self.thread.join(1.0)
        lines = [line.strip() for line in re.split(r"[\r\n]+", self.kept.decode("utf-8", "replace")) if line.strip()]
        return f": {brief(lines[-1])}" if lines else ": it printed nothing"

    def close(self) -> None:
        """Hear the rest; a child that lives on and holds the pipe is not waited for."""
        self.thread.join(1.0)
        if not self.thread.is_alive():
            self.stream.close()


@dataclass
class _Memory:
    """Main memory of a program and its children, looked at now and then; Linux alone tells."""

    pid: int
    peak: int = 0
    _seen: dict[int, int] = field(default_factory=dict)  # high-water mark of each process

    def look(self) -> None:
        total = 0
        for process in self._tree(self.pid):
            now, most = _status(process)
            total += now
            self._seen[process] = max(most, self._seen.get(process, 0))
        self.peak = max(self.peak, total, *self._seen.values(), 0)

    def _tree(self, pid: int) -> list[int]:
        listed: list[str] = []
        with suppress(OSError):  # it has ended
            for thread in Path(f"/proc/{pid}/task").iterdir():  # each lists the children that it started itself
                with suppress(OSError):
                    listed += (thread / "children").read_text(encoding="ascii").split()
        return [pid, *(process for child in listed for process in self._tree(int(child)))]


def _status(process: int) -> tuple[int, int]:
    """Bytes that a process holds now, and the most that it has held since it became the program that it is."""
    try:
        lines = Path(f"/proc/{process}/status").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return 0, 0
    found = {line.split()[0]: int(line.split()[1]) * 1024 for line in lines if line.startswith(("VmRSS:", "VmHWM:"))}
    return found.get("VmRSS:", 0), found.get("VmHWM:", 0)
