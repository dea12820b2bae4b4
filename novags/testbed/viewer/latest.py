"""Work that follows a slider: a thread that does the last request, and skips requests it has no time for."""

import threading
from collections.abc import Callable


class Latest:
    """A thread that calls `work` after it was asked to; requests that arrive meanwhile are one request."""

    def __init__(self, work: Callable[[frozenset[str]], None]) -> None:
        """`work` takes the parts that were asked for since it was called last."""
        self._work = work
        self._changed = threading.Condition()
        self._parts: set[str] = set()
        self._ended = False
        threading.Thread(target=self._serve, daemon=True, name="viewer").start()

    def ask(self, *parts: str) -> None:
        """Have these parts done, soon."""
        with self._changed:
            self._parts |= set(parts)
            self._changed.notify()

    def pending(self, part: str) -> bool:
        """Whether `part` was asked for again, or all is over: work under way need not be finished."""
        return self._ended or part in self._parts

    @property
    def over(self) -> bool:
        """Whether it was told to end."""
        return self._ended

    def end(self) -> None:
        """Do nothing more."""
        with self._changed:
            self._ended = True
            self._changed.notify()

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._parts or self._ended)
                if self._ended:
                    return
                parts, self._parts = frozenset(self._parts), set()
            self._work(parts)
