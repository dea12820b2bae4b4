"""Runs tests on a mutant: a forked process in which the import system hands out the changed text of one module.

Forks start warm, with the libraries imported, so a mutant costs little more than its tests. The files on disk are never
touched.
"""

import importlib
import importlib.abc
import importlib.util
import json
import os
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any

import pytest

from .baseline import Chosen, Recorder
from .mutants import Mutant

# Of pytest: some test failed; no test failed, but a file could not be imported (1 or 2); no test is left.
FAILED, BROKEN, NO_TESTS = 1, (1, 2), 5


@dataclass(frozen=True, kw_only=True)
class Job:
    """One mutant of one file, and the tests to run on it, in order."""

    file: str  # relative to the root
    mutant: Mutant
    key: str  # names the mutant
    about: str = ""  # names the tests of its group
    tests: tuple[str, ...]
    limit: float  # s, after which it counts as caught


class MutatedModule(importlib.abc.MetaPathFinder, SourceFileLoader):
    """Hands out a changed source for one module; byte code on disk is neither read nor written."""

    def __init__(self, root: Path, file: str, source: str) -> None:
        parts = Path(file).with_suffix("").parts
        self.package = parts[-1] == "__init__"
        super().__init__(".".join(parts[:-1] if self.package else parts), str(root / file))
        self.changed = source

    def find_spec(self, fullname: str, path: object, target: object = None) -> Any:
        """Ours for the one module; all others go to the next finder."""
        if fullname != self.name:
            return None
        where = [str(Path(self.path).parent)] if self.package else None
        return importlib.util.spec_from_file_location(
            fullname, self.path, loader=self, submodule_search_locations=where
        )

    def get_code(self, fullname: str) -> Any:
        """The changed source, compiled."""
        return compile(self.changed, self.path, "exec", dont_inherit=True)


def in_child(call: Callable[[], int], log: Path) -> int:
    """Fork, run `call` with its output in a file, exit with its result. Gives the child's process number."""
    sys.stdout.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads: ours takes nothing from them
        pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        os.setsid()  # a time limit ends the tests' own children too
        with log.open("wb") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        code = int(call())
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)  # the parent's own handlers and buffers are not the child's to run


def run_pytest(root: Path, tests: list[str], plugin: object, folder: Path) -> int:
    """Run pytest in this process, its temporary files in `folder`; its exit status."""
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # looking for plugins takes longer than most tests
    options = ["-q", "--assert=plain", "-p", "no:cacheprovider", f"--basetemp={folder / 'pytest'}", f"--rootdir={root}"]
    return int(pytest.main([*options, *tests], plugins=[plugin]))


def baseline(root: Path, sources: list[str], test: str, path: Path, longest: float = 10.0) -> dict[str, Any]:
    """Seconds and reached lines of every test of a file on the unchanged sources, kept in the file `path`."""
    if not path.exists():
        log = path.with_suffix(".log")
        with tempfile.TemporaryDirectory() as folder:
            recorder = Recorder({str(root / name): name for name in sources}, path, longest)
            pid = in_child(partial(run_pytest, root, [test], recorder, Path(folder)), log)
            code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        if code not in (0, FAILED, NO_TESTS) or not path.exists():
            path.unlink(missing_ok=True)
            raise SystemExit(f"{test} cannot be run: see {log}")
        if code == FAILED:
            print(f"{test} fails or takes too long; those of its tests that do are not asked: see {log}", flush=True)
    return json.loads(path.read_text(encoding="utf-8"))


def is_compiled(source: str) -> bool:
    """Whether numba compiles functions of a source: what calls them then is machine code, which nobody can watch."""
    return bool(re.search(r"^@(kernel|inline|jit|njit)\b", source, re.M))


def _judge(root: Path, job: Job, folder: Path) -> int:
    source = (root / job.file).read_text(encoding="utf-8")
    if is_compiled(source):
        # Machine code is kept under the name of the file on disk: this process must not take it, nor leave its own.
        importlib.import_module("numba").config.CACHE_DIR = str(folder / "numba")
    sys.meta_path.insert(0, MutatedModule(root, job.file, job.mutant.apply(source)))
    files = list(dict.fromkeys(test.split("::")[0] for test in job.tests))
    return run_pytest(root, ["-x", *files], Chosen(job.tests, folder / "failed"), folder)


def verdicts(root: Path, jobs: Iterable[Job], workers: int) -> Iterator[dict[str, Any]]:
    """Judge all jobs, some at a time: "caught", "survived", or "broken" where the module cannot even be imported.

    A job is taken when there is a place for it: what it takes to learn its tests need not be done before the first.
    """
    waiting, running = iter(jobs), dict[int, tuple[Job, Path, float]]()
    more = True
    while more or running:
        while more and len(running) < workers:
            job = next(waiting, None)
            if job is None:
                more = False
            elif not job.tests:
                yield _entry(job, "survived", "no test reaches it", 0.0)
            else:
                folder = Path(tempfile.mkdtemp(prefix="mutant-"))
                running[in_child(partial(_judge, root, job, folder), folder / "log")] = job, folder, time.monotonic()
        time.sleep(0.02)
        for pid, (job, folder, started) in list(running.items()):
            seconds = time.monotonic() - started
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                yield _entry(job, *_verdict(os.waitstatus_to_exitcode(status), folder), seconds)
            elif seconds > job.limit:
                os.killpg(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                yield _entry(job, "caught", "time limit", seconds)
            else:
                continue
            del running[pid]
            shutil.rmtree(folder, ignore_errors=True)


def _verdict(code: int, folder: Path) -> tuple[str, str]:
    failed = folder / "failed"
    if code == 0:
        return "survived", ""
    if code in BROKEN and not failed.exists():
        return "broken", "import"
    return "caught", failed.read_text(encoding="utf-8") if failed.exists() else f"exit status {code}"


def _entry(job: Job, verdict: str, by: str, seconds: float) -> dict[str, Any]:
    own = {
        "key": job.key,
        "tests": job.about,
        "file": job.file,
        "verdict": verdict,
        "by": by,
        "seconds": round(seconds, 1),
    }
    return own | asdict(job.mutant)
