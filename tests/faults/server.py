"""A process that has imported everything and runs commands in forked children, each under a fault of its own.

It reads requests from standard input, one JSON object a line, and answers each with one line. Forking costs
milliseconds where starting anew costs seconds. It has no threads of its own, because they would not survive a fork.
"""

import ctypes
import json
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import drjit
import torch

torch.set_num_threads(1)
cv2.setNumThreads(1)
# Mitsuba loads its differentiable integrators anew whenever the variant changes, and translating them takes seconds.
# Nothing here renders with them.
drjit.syntax = lambda function=None, **_: function if function is not None else (lambda other: other)

WRITES = ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.truncate", "os.symlink", "os.link")


class Events:
    """Counts what changes files under a folder; signals this process right before the event of a number.

    An event that opens a file for writing, or renames one that was written, counts twice: the second time the process
    dies with the file half-written. Compiled libraries write without events, but always under a temporary name that is
    renamed afterwards.
    """

    def __init__(self, root: Path, kill_at: int | None, with_: int) -> None:
        self.root, self.kill_at, self.signal = str(root.resolve()) + os.sep, kill_at, with_
        self.seen: list[str] = []
        self.busy = False

    def __call__(self, event: str, args: tuple[Any, ...]) -> None:
        if self.busy or (path := self._changed(event, args)) is None:
            return
        self.busy = True
        self._count(f"{event} {path}", lambda: None)
        if event == "open":
            self._count(f"half {path}", lambda: self._half_open(path))
        elif event == "os.rename" and os.path.isfile(path):
            self._count(f"half {path}", lambda: os.truncate(path, os.path.getsize(path) // 2))
        self.busy = False

    def _count(self, what: str, before: Callable[[], None]) -> None:
        if len(self.seen) == self.kill_at:
            before()
            os.kill(os.getpid(), self.signal)
        self.seen.append(what)

    def _changed(self, event: str, args: tuple[Any, ...]) -> str | None:
        """The path that the event changes, if it does and lies under the folder."""
        if event == "open":
            path, mode, flags = args
            if not isinstance(path, str | bytes | os.PathLike):
                return None
            writes = set(mode or "") & set("wax+") or (flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            return self._inside(path) if writes else None
        if event not in WRITES:
            return None
        if event in ("os.remove", "os.rmdir") and args[1] != -1:  # relative to an open folder: rmtree
            return os.path.join(os.readlink(f"/proc/self/fd/{args[1]}"), os.fsdecode(args[0]))
        return self._inside(args[0])

    def _inside(self, path: Any) -> str | None:
        if isinstance(path, int):
            path = os.readlink(f"/proc/self/fd/{path}")
        found = os.path.abspath(os.fsdecode(path))
        return found if found.startswith(self.root) else None

    @staticmethod
    def _half_open(path: str) -> None:
        with open(path, "a") as file:
            file.write('{"st')


def bound_by_permissions() -> None:
    """Give up root's right to write where the permission bits forbid it."""
    if os.geteuid() == 0:
        header, data = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
        libc = ctypes.CDLL(None, use_errno=True)
        assert libc.capget(header, data) == 0, os.strerror(ctypes.get_errno())
        for word in (0, 1):
            data[word] &= ~(1 << 1)  # CAP_DAC_OVERRIDE, effective and permitted
        assert libc.capset(header, data) == 0, os.strerror(ctypes.get_errno())


def limited(what: int, size: int) -> None:
    resource.setrlimit(what, (size, resource.getrlimit(what)[1]))


def memory_left(size: int) -> None:
    """Allow so many bytes of address space beyond what this process has."""
    ctypes.CDLL(None).malloc_trim(0)  # freed memory would do for a small command, and how much there is is chance
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limited(resource.RLIMIT_AS, pages * resource.getpagesize() + size)


def clock_moved(seconds: float) -> None:
    now, now_ns = time.time, time.time_ns
    time.time = lambda: now() + seconds
    time.time_ns = lambda: now_ns() + int(seconds * 1e9)


def clock_runs_back() -> None:
    now = time.time
    start = now()
    time.time = lambda: 2 * start - now()
    time.time_ns = lambda: int((2 * start - now()) * 1e9)


def without_llvm() -> None:
    from simscenes import backend

    backend.llvm_candidates = list  # type: ignore[assignment]
    backend._working_llvm.cache_clear()


def gpu_memory_full(after: int) -> None:
    """Fail as a full GPU does in the `after`-th iteration of a fit."""
    import importlib

    iteration: Any = importlib.import_module("novags.splats.training.iteration")
    direct: Any = importlib.import_module("novags.splats.training.direct")
    render, left = iteration.render_step, [after]

    def step(*args: Any, **kwargs: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            raise torch.cuda.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB. GPU 0 has ...\nmore")
        return render(*args, **kwargs)

    iteration.render_step = step
    direct.DirectFit.takes = lambda *_: False  # no GPU fits so


FAULTS: dict[str, Callable[..., None]] = {
    "largest file": lambda size: limited(resource.RLIMIT_FSIZE, size),
    "memory left": memory_left,
    "permissions": bound_by_permissions,
    "clock moved": clock_moved,
    "clock runs back": clock_runs_back,
    "no llvm": without_llvm,
    "gpu memory full": gpu_memory_full,
    "environment": os.environ.update,
}


def child(request: dict[str, Any], report: Path) -> None:
    """Run one command and leave through `os._exit`."""
    log = os.open(report.with_suffix(".log"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    sys.stdout = os.fdopen(1, "w", closefd=False)  # not where the server answers
    signal.signal(signal.SIGINT, signal.default_int_handler)
    events, code = None, 0
    try:
        os.chdir(request["folder"])
        for name, arguments in request.get("faults", {}).items():
            FAULTS[name](*arguments)
        if "events" in request:
            at = Path(request["folder"]) / request["events"]
            events = Events(at, request.get("kill"), request.get("signal", signal.SIGKILL))
            sys.addaudithook(events)
        sys.argv = ["novags", *request["command"]]
        from novags.cli import main

        main()
    except SystemExit as stop:
        code = int(stop.code or 0)
    except BaseException:
        traceback.print_exc()
        code = 99
    if events is not None:
        events.busy = True
        report.write_text(json.dumps(events.seen))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def serve() -> None:
    reports, number = Path(sys.argv[1]), 0
    for line in sys.stdin:
        request = json.loads(line)
        answer: dict[str, Any] = {}
        if "wait" in request:
            process, report = request["wait"]
            status = os.waitpid(process, 0)[1]
            answer = {"code": os.waitstatus_to_exitcode(status), "said": Path(report).with_suffix(".log").read_text()}
            if Path(report).exists():
                answer["events"] = json.loads(Path(report).read_text())
        else:
            number += 1
            report = reports / f"{number}.json"
            process = os.fork()
            if process == 0:
                child(request, report)
            answer = {"process": [process, str(report)]}
        print(json.dumps(answer), flush=True)


def warm(folder: Path) -> None:
    """Load all modules and every kernel that a command calls, without a thread. Mitsuba stays without a variant."""
    import mitsuba  # noqa: F401

    os.chdir(folder)
    for words in json.loads(sys.argv[3]):
        if words[0] == "render":
            request = {"folder": str(folder), "command": words}
            process = os.fork()
            if process == 0:
                child(request, folder / "render.json")
            assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0, (folder / "render.log").read_text()
            continue
        sys.argv[1:], kept = words, sys.argv[1:]
        from novags.cli import main

        main()
        sys.argv[1:] = kept


if __name__ == "__main__":
    out = os.dup(1)
    os.dup2(2, 1)  # what commands print must not get between the answers
    warm(Path(sys.argv[2]))
    sys.stdout = os.fdopen(out, "w")
    print("{}", flush=True)
    serve()
    os._exit(0)  # without the seconds that the interpreter takes to clear up
