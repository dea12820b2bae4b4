"""How long a piece of work still takes, each of its parts at its own pace.

The bars are rich's, its estimate is not: it knows no parts. With 300 quick steps of a denoiser before 700 slow ones of
a fit it promised 15 s where 211 were left.
"""

import time
from collections.abc import Callable, Mapping

PREPARED = 0.05  # share of a part's steps: time until a first report sooner than that went into preparing the part


class TimeLeft:
    """Seconds left of work whose parts follow each other, and whose steps are counted through.

    The part that is under way is extrapolated from its own steps, without the time before the first of them. A later
    one takes as long as its steps took before, preparation included: in this work if it has begun already, else in
    other work of this process, which `paces` remembers.
    """

    def __init__(
        self, work: str, parts: Mapping[str, int], paces: dict[str, float], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start the clock.

        Args:
            work: Its name.
            parts: Steps of each part, in order; none: there is one part.
            paces: Seconds per step by part, measured so far; read and written.
            clock: Seconds.
        """
        self.work, self.parts, self.paces, self.clock = work, dict(parts), paces, clock
        self.part: str | None = None
        self.last = clock()  # report
        self.whole = self.steps = (self.last, 0)  # when the part under way began, and after how many steps; its steps

    def update(self, done: int, total: int) -> str:
        """After `done` of `total` steps: "12 s left", or "12 s left, then fit" if that has no known pace.

        "" where nobody knows how many steps there are, which `total` 0 says.
        """
        if not total:
            return ""
        now = self.clock()
        parts = self.parts if sum(self.parts.values()) == total else {"": total}
        part, begin, end = _part_of(parts, done)
        if part != self.part:
            # The time before the first step of a later part belongs to it. Of resumed work only the part done now
            # counts.
            self.whole = (now, done) if self.part is None else (self.last, begin)
            self.steps = (now, done) if done - begin <= PREPARED * (end - begin) else self.whole
            self.part = part
        self.last = now
        pace_now = _pace(now, done, self.steps)
        if pace_now is None:
            pace_now = self._remembered(part)
        else:
            self.paces[f"{self.work}/{part}"] = self.paces[part] = _pace(now, done, self.whole) or pace_now
        if done >= total or pace_now is None:
            return ""
        seconds, unknown = pace_now * (end - done), []
        for name, steps in list(parts.items())[list(parts).index(part) + 1 :]:
            pace_then = self._remembered(name)
            if pace_then is None:
                unknown.append(name)
            else:
                seconds += pace_then * steps
        return f"{seconds:.0f} s left" + "".join(f", then {name}" for name in unknown)

    def _remembered(self, part: str) -> float | None:
        return self.paces.get(f"{self.work}/{part}", self.paces.get(part) if part else None)


def _pace(now: float, done: int, since: tuple[float, int]) -> float | None:
    """Seconds per step since a time and a step; None if there was none."""
    seconds, steps = now - since[0], done - since[1]
    return seconds / steps if seconds > 0 and steps > 0 else None


def _part_of(parts: Mapping[str, int], done: int) -> tuple[str, int, int]:
    """The part that the step number `done` belongs to, and the steps before it begins and when it ends."""
    begin = 0
    for name, steps in parts.items():
        if done <= begin + steps and steps:
            return name, begin, begin + steps
        begin += steps
    return name, begin - steps, begin
