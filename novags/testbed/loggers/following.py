"""Follow the event files of runs while a command makes them, and hand each new line to a logger."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from threading import Event, Thread

from novags.testbed.console.terminal import Console
from novags.testbed.folders.events import event_of
from novags.testbed.folders.run import EVENTS
from novags.testbed.loggers import LOGGERS, Sink
from sensor_model.files.door import read_bytes

POLL = 1.0  # s


@contextmanager
def logged(out: Path, logger: str | None, console: Console) -> Iterator[None]:
    """While the block runs, losses of the run in `out`, and of those in its folders, go to a logger.

    Its files lie in `<out>.logs/LOGGER`, beside the results, which stay as they are without a logger. Steps that were
    there before are not sent again. A logger that fails is left alone: it costs a note, and no work.

    Args:
        out: Folder of a run, or of an experiment.
        logger: Of `LOGGERS`; None: there is none.
        console: Where notes go.

    Raises:
        ValueError: If its package is not installed.
    """
    if logger is None:
        yield
        return
    _check(logger)
    following = _Following(out, logger)
    stop = Event()
    thread = Thread(target=following.go_on, args=(stop,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        if following.failed is not None:
            console.warn(f"--log {logger} ended with an error, and the work went on: {following.failed}")
        elif following.sinks:
            console.note(f"{logger}: {following.folder}")


def _check(logger: str) -> None:
    if find_spec(logger) is None:
        raise ValueError(f"--log {logger} needs its package, which is not installed: pip install 'novags[{logger}]'")


class _Following:
    """The event files that were seen so far."""

    def __init__(self, out: Path, logger: str) -> None:
        self.out, self.logger, self.folder = out, logger, out.with_name(f"{out.name}.logs") / logger
        self.sinks: dict[Path, Sink] = {}
        self.failed: str | None = None
        self.sent = {path: list(_events(path)) for path in self._files()}

    def _files(self) -> list[Path]:
        return [*self.out.glob(EVENTS), *sorted(self.out.glob(f"*/{EVENTS}"))]

    def go_on(self, stop: Event) -> None:
        """Send new lines every now and then, and the last ones in the end."""
        try:
            while not stop.wait(POLL):
                self._send()
            self._send()
            for sink in self.sinks.values():
                sink.close()
        except BaseException as error:  # of any logger, of any kind: the work is worth more
            self.failed = f"{type(error).__name__}: {error}"

    def _send(self) -> None:
        for path in self._files():
            events, sent = list(_events(path)), self.sent.get(path, [])
            # From where another run goes on in that file; one that goes on from a checkpoint repeats its own steps.
            other = next((k for k, pair in enumerate(zip(events, sent, strict=False)) if pair[0] != pair[1]), None)
            sent = sent[:other]
            for step, values in events[len(sent) :]:
                if path not in self.sinks:
                    self.sinks[path] = LOGGERS[self.logger](self.folder, path.parent.name)
                self.sinks[path].add(step, values)
            self.sent[path] = [*sent, *events[len(sent) :]]


def _events(path: Path) -> Iterator[tuple[int, Mapping[str, float]]]:
    """The whole lines of an event file: steps, and the finite numbers of each."""
    try:
        text = read_bytes(path).decode("utf-8", "replace")
    except (OSError, ValueError):  # it is being replaced
        return
    for line in text.splitlines(keepends=True):
        if not line.endswith("\n"):
            return
        try:
            event = event_of(line, str(path))
            step = int(event["step"])
        except (KeyError, TypeError, ValueError):  # damaged: the run itself refuses it, or begins anew
            return
        yield step, {name: float(value) for name, value in event.items() if name != "step"
                                   and isinstance(value, int | float) and math.isfinite(value)}  # fmt: skip
