"""Run a kernel over a range with threads.

The caller works too, and ranges are handed out as they are asked for: a helper thread that the operating system does
not schedule in time costs nothing, where a barrier of equal shares would wait for it. Results do not depend on who did
what.
"""

import itertools
import os
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

import torch

CHUNKS_PER_THREAD = 6  # enough that the last chunk is short, few enough that handing out costs little


class _Job:
    def __init__(self, kernel: Callable[..., Any], n: int, step: int, args: tuple[Any, ...]) -> None:
        self.kernel, self.n, self.step, self.args = kernel, n, step, args
        self.starts = itertools.count(0, step)  # next() on it is atomic
        self.lock, self.finished = threading.Lock(), threading.Semaphore(0)
        self.active, self.closed = 0, False
        self.error: BaseException | None = None

    def work(self) -> None:
        for begin in self.starts:
            if begin >= self.n:
                return
            self.kernel(begin, min(begin + self.step, self.n), *self.args)

    def help(self) -> None:
        with self.lock:
            if self.closed:
                return
            self.active += 1
        try:
            self.work()
        except BaseException as error:  # handed to the caller's thread
            self.error = error
        with self.lock:
            self.active -= 1
            if self.closed and self.active == 0:
                self.finished.release()

    def close(self) -> None:
        with self.lock:
            self.closed = True
            waiting = self.active > 0
        if waiting:
            self.finished.acquire()
        self.args = ()  # a helper that comes too late must not keep the arrays alive
        if self.error is not None:
            raise self.error


_jobs: SimpleQueue[_Job] = SimpleQueue()
_threads: list[threading.Thread] = []


def _serve(jobs: SimpleQueue[_Job]) -> None:
    while True:
        jobs.get().help()


def _forget() -> None:
    """After a fork the child has the list of threads but not the threads."""
    global _jobs
    _jobs = SimpleQueue()
    _threads.clear()


os.register_at_fork(after_in_child=_forget)


def run(kernel: Callable[..., Any], n: int, grain: int, *args: Any) -> None:
    """Call kernel(begin, end, *args) on ranges that cover 0..n-1.

    Args:
        kernel: A compiled kernel (releases the GIL).
        n: Number of items.
        grain: Ranges begin at multiples of this and are at least this long; work too small to share should be one
            grain.
        args: Passed on.
    """
    workers = min(torch.get_num_threads(), -(-n // grain))
    if workers <= 1:
        if n > 0:
            kernel(0, n, *args)
        return
    while len(_threads) < workers - 1:
        _threads.append(threading.Thread(target=_serve, args=(_jobs,), daemon=True, name="splats"))
        _threads[-1].start()
    grains = -(-n // (workers * CHUNKS_PER_THREAD * grain))
    job = _Job(kernel, n, grains * grain, args)
    for _ in range(workers - 1):
        _jobs.put(job)
    try:
        job.work()
    finally:
        job.close()
