"""Parts that commands share: the console, the lock on output, what to do next, words that stand for settings."""

import shlex
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

if TYPE_CHECKING:  # heavy: torch and its friends load when a command runs, so that --help answers at once
    from novags.methods.variant import Variant
    from novags.testbed.console.terminal import Console


def variants_of(texts: tuple[str, ...]) -> "tuple[Variant, ...]":
    """The variants that `--variant` names: spelled out, or from a TOML file."""
    from novags.methods.variant import parse_variant
    from novags.testbed.study.cells.presets import variants_in

    found = [variants_in(Path(text)) if text.endswith(".toml") else (parse_variant(text),) for text in texts]
    return tuple(variant for variants in found for variant in variants)


def cameras_of(text: str | None) -> Any:
    """The camera source that `--cameras` names; None for None."""
    from novags.cameras import parse_cameras

    return None if text is None else parse_cameras(text)


def typed(path: Path) -> str:
    """A path as typed into a shell, so that a dash at its beginning starts no option."""
    return shlex.quote(f"./{path}" if str(path).startswith("-") else str(path))


def say(what: object, stream: TextIO | None = None) -> None:
    """Print a result, on standard output if not told otherwise; names from outside in it cannot steer the terminal."""
    from novags.testbed.console.terminal import shown

    print(shown(str(what)), file=stream, flush=True)


def next_(command: str) -> None:
    """Print the next command, its paths as `typed`; on standard error, so that standard output holds only results."""
    say(f"next: {command}", sys.stderr)


def console() -> "Console":
    """A console; from here on, termination is an interruption like Ctrl-C."""
    import pycolmap  # noqa: F401 - its crash handler would take SIGTERM over if it were imported later

    from novags.testbed.console.terminal import Console

    signal.signal(signal.SIGTERM, terminated)
    return Console()


@contextmanager
def writing(folder: Path, wait: bool, *, dry_run: bool = False, **lock: Any) -> "Iterator[Console]":
    """Hold a folder while a command writes there; in a dry run nothing is held, and the block ends where work begins.

    `lock`: further arguments of `locked`.
    """
    from novags.testbed.console.terminal import warnings_as_notes
    from novags.testbed.ledger.dry import dry_run as dry
    from sensor_model.files.lock import locked

    said = console()
    with dry(dry_run), ExitStack() as held:
        with warnings_as_notes(said):
            held.enter_context(locked(folder, wait=said.note if wait else None, **lock))
        yield said


def terminated(*_: object) -> NoReturn:
    """A signal handler."""
    raise KeyboardInterrupt


def command_line(folder: Path) -> str:
    """The typed command, in a form that does the same when it is run in `folder`."""
    from novags.testbed.report.again import relative_command

    return relative_command(sys.argv[1:], folder)


ELSE = "novags run --scene cornell, or novags list for what else is available"


def announce(path: Path, then: str = ELSE) -> None:
    """Say where a report is, and what to do next."""
    say(f"report: {path.resolve()}")
    say(f"open it in a browser: {path.resolve().as_uri()}")
    next_(then)


def say_ranking(folder: Path) -> None:
    """Say which method came first, with errors and ties, as the report of the folder begins."""
    from novags.testbed.report.page import ranking_of

    for line in ranking_of(folder):
        say(line)
