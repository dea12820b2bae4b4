"""Progress of a study: a bar for all of it and a line for each task under way, or plain lines in a log."""

import time
from collections.abc import Mapping

from rich.progress import TaskID

from novags.testbed.console.terminal import Console, shown

PLAIN_INTERVAL = 15.0  # s between two plain lines
At = tuple[str, int, int, str]  # stage, steps done, steps in all, what


class StudyProgress:
    """Shows how many runs are done, the work of each worker and how long it will take.

    Args:
        console: Where it goes.
        runs: Of the study.
    """

    def __init__(self, console: Console, runs: int) -> None:
        self.console, self.runs = console, runs
        self.bars = console.bars("<44.44", 24) if console.live else None
        self.lines: dict[str, TaskID] = {}
        self.last = 0.0
        if self.bars is not None:
            self.bars.start()
            self.all = self.bars.add_task("runs", total=runs, what="")

    def note(self, text: str) -> None:
        """Print a line, above the bars where there are some."""
        self.console.note(text)

    def show(self, done: int, failed: int, under_way: Mapping[str, tuple[str, At]], left: float) -> None:
        """Show where the study is.

        Args:
            done: Runs that are over.
            failed: Of these.
            under_way: Name and progress of the tasks that workers are at, by key.
            left: Seconds that it will still take.
        """
        what = f"{failed} failed, " * bool(failed) + f"{duration(left)} left"
        if self.bars is not None:
            self._update(done, under_way, what)
        elif time.monotonic() - self.last >= PLAIN_INTERVAL:
            self.last = time.monotonic()
            doing = [f"{name}: {stage}{f' {k}/{n}' * bool(n)}" for name, (stage, k, n, _) in under_way.values()]
            self.note("  | ".join([f"study: {done}/{self.runs} runs, {what}", *doing]))

    def _update(self, done: int, under_way: Mapping[str, tuple[str, At]], what: str) -> None:
        assert self.bars is not None
        self.bars.update(self.all, completed=done, what=what)
        for key in [key for key in self.lines if key not in under_way]:
            self.bars.remove_task(self.lines.pop(key))
        for key, (name, (stage, k, n, at)) in under_way.items():
            if key not in self.lines:
                self.lines[key] = self.bars.add_task(f"  {shown(name)}", total=None, what="")
            self.bars.update(self.lines[key], completed=k, total=n or None, what=shown(f"{stage} {at}"))

    def close(self) -> None:
        """Restore the terminal."""
        if self.bars is not None:
            self.bars.stop()


def duration(seconds: float) -> str:
    """Seconds in the unit that suits them."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
