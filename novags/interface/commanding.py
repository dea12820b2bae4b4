"""Commands from Python: each in a process of its own, so that its results are those of the command line to the bit."""

import inspect
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread
from typing import Any, get_args

import tyro

from novags.commands.experiment import run as run_command
from novags.commands.study import study as study_command
from novags.interface.opening import StudyResults, results_of
from sensor_model.files.python import python

PROGRAM = "from novags.__main__ import main; main()"
NOT_HERE = ("file", "cluster", "dry_run")  # the first is an argument of its own, the second a group of options
LINES = 200  # of what a command said, kept


class CommandError(RuntimeError):
    """A command ended with an error, or was stopped; the message is what it said last."""


class BackgroundCommand:
    """A command under way in a process of its own.

    Attributes:
        command: As typed, without "novags".
        out: Folder of its results.
        said: The last lines that it printed, the newest last; of progress "study: 2/6 runs, 3 min left | ...".
    """

    def __init__(self, command: list[str], out: Path, show: bool) -> None:
        self.command, self.out, self.said = command, out, deque[str](maxlen=LINES)
        self._process = subprocess.Popen(
            python(PROGRAM, *command), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
            encoding="utf-8", errors="replace",
        )  # fmt: skip
        self._reader = Thread(target=self._read, args=(show,), daemon=True)
        self._reader.start()

    def _read(self, show: bool) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                self.said.append(line.rstrip("\n"))
                if show:
                    print(line, end="", file=sys.stderr, flush=True)

    @property
    def running(self) -> bool:
        """Whether it is under way."""
        return self._process.poll() is None

    @property
    def progress(self) -> str:
        """The last line that it printed: the stage, how far it is, and the time left; "" before the first one."""
        return self.said[-1] if self.said else ""

    def wait(self, timeout: float | None = None) -> StudyResults:
        """Wait until it is done; its results. Ctrl-C stops the command too, which continues when it is run again.

        Args:
            timeout: Seconds; None: as long as it takes.

        Raises:
            CommandError: If it ended with an error or was stopped.
            TimeoutError: If it is not done by then; it goes on.
        """
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"novags {self.command[0]} is not done after {timeout:g} s: {self.progress}") from None
        except KeyboardInterrupt:
            self.stop()
            raise
        self._reader.join()
        if code:
            raise CommandError(f"novags {self.command[0]} ended with {code}: {self.progress}")
        return results_of(self.out)

    def stop(self) -> None:
        """Interrupt it, as Ctrl-C does: finished work is kept, and the same command continues."""
        if self.running:
            self._process.send_signal(signal.SIGINT)
        self._process.wait()
        self._reader.join()


def run(*, out: str | Path, background: bool = False, show: bool = True, **settings: Any) -> Any:
    """Run a whole experiment, as `novags run` does: render, capture in the dark, reconstruct, score, report.

    Args:
        out: Folder of the experiment. Finished work in it is kept: the same call again does only the rest.
        background: Return a `BackgroundCommand` at once instead of the results.
        show: Print its progress.
        settings: The options of `novags run` by their names: scene="cornell", electrons=20, methods=["naive"].

    Returns:
        `StudyResults`, or a `BackgroundCommand` with them.

    Raises:
        ValueError: If there is no such option.
        CommandError: If it fails, with what the command said.
    """
    return _started(run_command, [], Path(out), settings, background, show)


def study(file: str | Path, *, out: str | Path, background: bool = False, show: bool = True, **settings: Any) -> Any:
    """Run a grid of runs from a file, as `novags study` does.

    Args:
        file: The study, a TOML file.
        out: Folder of its tables and logs. Finished work is kept.
        background: As for `run`, like the next.
        show: Print its progress.
        settings: The options of `novags study` by their names: store, workers, ...

    Returns:
        `StudyResults`, or a `BackgroundCommand` with them.

    Raises:
        ValueError: If there is no such option.
        CommandError: If it fails, with what the command said.
    """
    return _started(study_command, [str(file)], Path(out), settings, background, show)


def _started(
    command: Callable[..., None], words: list[str], out: Path, settings: dict[str, Any], background: bool, show: bool
) -> StudyResults | BackgroundCommand:
    name, known = command.__name__, inspect.signature(command).parameters
    if unknown := [setting for setting in settings if setting not in known or setting in NOT_HERE]:
        raise ValueError(f"novags {name} has no option {', '.join(unknown)} here: `novags {name} --help` lists them")
    options = [word for setting, value in settings.items() for word in _words(setting, value, known[setting])]
    job = BackgroundCommand([name, *words, "--out", str(out), *options], out, show)
    return job if background else job.wait()


def _words(setting: str, value: Any, parameter: inspect.Parameter) -> Iterator[str]:
    """An option as typed."""
    option, values = f"--{setting.replace('_', '-')}", value if isinstance(value, list | tuple) else [value]
    if value is None or value is False:
        return
    if tyro.conf.UseAppendAction in get_args(parameter.annotation):  # once for each value
        yield from (word for one in values for word in (option, str(one)))
        return
    yield option
    if value is not True:
        yield from map(str, values)
