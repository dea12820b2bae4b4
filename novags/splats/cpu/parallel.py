"""Run a kernel over a range, or a chain of kernels, with threads.

The caller works too, and ranges are handed out on demand: a helper thread that the operating system does not schedule
in time costs nothing, where a barrier of equal shares would wait for it. Results do not depend on the sharing of work.
"""

import itertools
import os
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

import torch

from .chains.stages import CHUNKS_PER_THREAD, give_up, new_control

CHAIN_GRAIN = 512  # Gaussians or pixels per thread; for fewer, waking a thread costs more than it saves


class _Job:
    """Work that the caller begins at once and helpers join; `give_up` is called when one of them has failed."""

    def __init__(self, work: Callable[[], None], give_up: Callable[[], None]) -> None:
        self.work, self.give_up = work, give_up
        self.lock, self.finished = threading.Lock(), threading.Semaphore(0)
        self.active, self.closed = 0, False
        self.error: BaseException | None = None

    def help(self) -> None:
        with self.lock:
            if self.closed:
                return
            self.active += 1
        try:
            self.work()
        except BaseException as error:  # handed to the caller's thread
            self.error = error
            self.give_up()
        with self.lock:
            self.active -= 1
            if self.closed and self.active == 0:
                self.finished.release()

    def share(self, helpers: int) -> None:
        """Call help from this thread and from helpers; returns when nobody works any more."""
        while len(_threads) < helpers:
            _threads.append(threading.Thread(target=_serve, args=(_jobs,), daemon=True, name="splats"))
            _threads[-1].start()
        for _ in range(helpers):
            _jobs.put(self)
        try:
            self.work()
        except BaseException:
            self.give_up()
            raise
        finally:
            self._close()

    def _close(self) -> None:
        with self.lock:
            self.closed = True
            waiting = self.active > 0
        if waiting:
            self.finished.acquire()
        del self.work, self.give_up  # a helper that comes too late must not keep the arrays alive
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
    step = -(-n // (workers * CHUNKS_PER_THREAD * grain)) * grain
    starts = itertools.count(0, step)  # next() on it is atomic

    def work() -> None:
        for begin in starts:
            if begin >= n:
                return
            kernel(begin, min(begin + step, n), *args)

    _Job(work, _nothing).share(workers - 1)


def _nothing() -> None:
    """The ranges that are left are taken by the others."""


def run_chain(chain: Callable[..., Any], n: int, *args: Any) -> None:
    """Call chain(control, threads, *args) from as many threads as n items are worth; see `chains.stages`."""
    threads, control = max(1, min(torch.get_num_threads(), n // CHAIN_GRAIN)), new_control()
    if threads == 1:
        chain(control, 1, *args)
        return
    _Job(lambda: chain(control, threads, *args), lambda: give_up(control)).share(threads - 1)
