"""Stopwatches of the measurements."""

import time
from collections.abc import Callable
from typing import Any


class Clock:
    """Seconds on the wall and of all processors since it was made."""

    def __init__(self) -> None:
        self.wall, self.cpu = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float]:
        """(wall, processors)."""
        return time.perf_counter() - self.wall, time.process_time() - self.cpu


def fastest(call: Callable[[], Any], repeat: int, seconds: float = 20.0) -> tuple[float, float]:
    """Least seconds of a call, on the wall and of all processors.

    Args:
        call: The function to time; it has run once before, so that everything it needs is compiled and cached.
        repeat: Most calls; at least one.
        seconds: No further call after these, except that there are three if `repeat` allows it.
    """
    begun, found = Clock(), list[tuple[float, float]]()
    while len(found) < min(3, repeat) or (len(found) < repeat and begun.read()[0] < seconds):
        clock = Clock()
        call()
        found.append(clock.read())
    return min(wall for wall, _ in found), min(cpu for _, cpu in found)
