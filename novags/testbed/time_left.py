"""How long a piece of work still takes, each of its parts at its own pace."""

import time
from collections.abc import Callable, Mapping


class TimeLeft:
    """Seconds left of work whose parts follow each other, and whose steps are counted through.

    The part that is under way is extrapolated from its own steps. A later one takes what its steps took before: in this
    work if it has begun already, else in other work of this process, which `paces` remembers.
    """

    def __init__(
        self, work: str, parts: Mapping[str, int], paces: dict[str, float], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """
        Args:
            work: Its name.
            parts: Steps of each part, in order; none: there is one part.
            paces: Seconds per step by part, measured so far; read and written.
            clock: Seconds.
        """  # noqa: D205, D212
        self.work, self.parts, self.paces, self.clock = work, dict(parts), paces, clock
        self.part: str | None = None
        self.began, self.first = clock(), 0  # of the part that is under way: when, and after how many steps
        self.last = self.began

    def update(self, done: int, total: int) -> str:
        """After `done` of `total` steps: "12 s left", or "12 s left, then fit" if nobody knows how long that takes."""
        now = self.clock()
        parts = self.parts if sum(self.parts.values()) == total else {"": total}
        part, begin, end = _part_of(parts, done)
        if part != self.part:
            # What came before the first step of a later part belongs to it. Of resumed work what is done now counts.
            resumed = self.part is None
            self.began, self.first = (now, done) if resumed else (self.last, begin)
            self.part = part
        self.last = now
        if done > self.first and now > self.began:
            pace = (now - self.began) / (done - self.first)
            self.paces[f"{self.work}/{part}"] = self.paces[part] = pace
        pace_now = self._pace(part)
        if done >= total or pace_now is None:
            return ""
        seconds, unknown = pace_now * (end - done), []
        for name, steps in list(parts.items())[list(parts).index(part) + 1 :]:
            pace_then = self._pace(name)
            if pace_then is None:
                unknown.append(name)
            else:
                seconds += pace_then * steps
        return f"{seconds:.0f} s left" + "".join(f", then {name}" for name in unknown)

    def _pace(self, part: str) -> float | None:
        return self.paces.get(f"{self.work}/{part}", self.paces.get(part) if part else None)


def _part_of(parts: Mapping[str, int], done: int) -> tuple[str, int, int]:
    """The part that the step number `done` belongs to, and the steps before it begins and when it ends."""
    begin = 0
    for name, steps in parts.items():
        if done <= begin + steps and steps:
            return name, begin, begin + steps
        begin += steps
    return name, begin - steps, begin
