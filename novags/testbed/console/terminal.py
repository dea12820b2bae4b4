"""Progress on the terminal: a live bar on a terminal, plain lines elsewhere. Everything goes to standard error."""

import re
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TextIO

from rich.console import Console as RichConsole
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from novags.testbed.console.time_left import TimeLeft
from sensor_model.files.reading import printable

# Steps done, total steps (0: nobody knows), and the current activity (a view, a loss).
Update = Callable[[int, int, str], None]
PLAIN_INTERVAL = 5.0  # s between two plain lines of one stage: shows progress, and suits a log file


class Console:
    """Where stages report their progress."""

    def __init__(self, *, quiet: bool = False, stream: TextIO | None = None) -> None:
        self.quiet = quiet
        self.stream = stream if stream is not None else sys.stderr
        self._rich = RichConsole(file=self.stream, highlight=False, soft_wrap=True)
        self.live = not quiet and self._rich.is_terminal
        self._warned: set[str] = set()
        self._paces: dict[str, float] = {}

    def note(self, text: str) -> None:
        """Print one line."""
        if not self.quiet:
            self._rich.print(shown(text), markup=False)

    def warn(self, text: str) -> None:
        """Print one line, once: every stage opens the same folders and meets the same oddities."""
        if text not in self._warned:
            self._warned.add(text)
            self.note(f"note: {text}")

    @contextmanager
    def progress(self, stage: str, parts: Mapping[str, int] | None = None) -> Iterator[Update]:
        """Show how far `stage` is; the yielded function takes (done, total, what).

        Args:
            stage: Its name.
            parts: Its parts in order and their steps, of which `done` counts the sum, where a step takes longer in one
                than in another.
        """
        left = TimeLeft(stage, parts or {}, self._paces)
        if self.quiet:
            yield lambda done, total, what: None
        elif self.live:
            with self.bars("<22", 30) as bar:
                task = bar.add_task(shown(stage), total=None, what="")
                yield lambda done, total, what: bar.update(
                    task, completed=done, total=total or None, what=shown(_with_left(left, done, total, what))
                )
        else:
            yield self._lines(stage, left)

    def bars(self, names: str, length: int) -> Progress:
        """Bars on the terminal; their names are formatted like this, and the field `what` stands at the end."""
        return Progress(
            TextColumn(f"{{task.description:{names}}}", markup=False),  # the name of a folder may hold brackets
            BarColumn(length),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[what]}", markup=False),  # and the name of a view may, too
            console=self._rich,
        )

    def _lines(self, stage: str, left: TimeLeft) -> Update:
        last = time.monotonic()

        def update(done: int, total: int, what: str) -> None:
            nonlocal last
            text, now = _with_left(left, done, total, what), time.monotonic()
            if now - last < PLAIN_INTERVAL and (done < total or not total):
                return
            last = now
            self.note(f"{stage}: {done}/{total}  {text}" if total else f"{stage}: {text}")

        return update


def shown(text: str) -> str:
    """Lines as they can be shown on a terminal, which would obey ESC, say, in a name of somebody's."""
    return re.sub(r"[^\n\t]+", lambda found: printable(found[0]), text)


def _with_left(left: TimeLeft, done: int, total: int, what: str) -> str:
    """The activity and the time left, of which some stages give their own estimate."""
    text = left.update(done, total)
    return f"{what}  {text}" if text and "left" not in what else what


def losses_text(losses: Mapping[str, float]) -> str:
    """Losses of one step in a few characters; counters and norms among them are left out."""
    shown = (name for name in losses if name not in ("iteration", "n_gaussians") and not name.startswith("norm_"))
    return "  ".join(f"{name} {losses[name]:.4f}" for name in shown)


@contextmanager
def warnings_as_notes(console: Console) -> Iterator[None]:
    """Show warnings (say, about images that a camera file lists but that are missing) as plain lines."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        yield
    for warning in caught:
        console.warn(str(warning.message))
