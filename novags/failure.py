"""What the command line says when a command fails: one line, and for unexpected errors a file with the traceback."""

import os
import re
import select
import shlex
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

TURNING = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
OURS = ("novags.", "simscenes.", "sensor_model.")
NAME = re.compile(r"[^\s/]{256,}")  # longer than any file can be called: repeating it whole would hide the rest
INTERRUPTED = "interrupted; the same command again continues where this one stopped"


@contextmanager
def errors_in_one_line() -> Iterator[None]:
    """Around a command.

    Wrong input gives one line on standard error and exit code 2; a refusal of the system, or an error that novags did
    not expect, one line and 1. NOVAGS_TRACEBACK=1 shows the whole traceback instead. A command whose output nobody
    reads any more, as in `novags list | head -1`, says nothing and ends with 141, as SIGPIPE would end it.
    """
    try:
        _check_words(sys.argv[1:])
        yield
        _end_if_nobody_reads()
    except KeyboardInterrupt:
        sys.exit(_say(INTERRUPTED, 130))
    except SystemExit as end:
        if not end.code:
            _end_if_nobody_reads()
        raise
    except BaseException as error:  # panics of libraries written in Rust are not Exceptions
        if isinstance(error, BrokenPipeError):
            _end_if_nobody_reads()
        if os.environ.get("NOVAGS_TRACEBACK"):
            raise
        if _is_interruption(error):
            sys.exit(_say(INTERRUPTED, 130))
        if isinstance(error, ValueError | OSError) or (isinstance(error, MemoryError) and str(error)):
            sys.exit(_say(f"error: {_brief(error, 2000)}", 2 if isinstance(error, ValueError) else 1))
        sys.exit(_say(f"error: {_brief(explained(error), 3000)}", 1))


@contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Around a command: a warning of ours that no console took over is one line, without a place in the source."""

    def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if category is UserWarning:
            _say(f"warning: {message}", 0)
        else:
            before(message, category, *place)

    with warnings.catch_warnings():
        before = warnings.showwarning
        warnings.showwarning = show  # type: ignore[assignment] # by place alone
        yield


def _is_interruption(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error: libraries in C++ that are being loaded make an ImportError of it, and say so."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error is not None


def _end_if_nobody_reads() -> None:
    """End the process if standard output is a pipe whose reader has gone."""
    if sys.stdout is None:
        return  # it was closed from the start, and Python prints nothing
    try:
        output = sys.stdout.fileno()
    except (OSError, ValueError):
        return  # a stream in memory has taken its place, as in tests: that has no reader to lose
    poll = select.poll()
    poll.register(output, 0)
    if any(event & select.POLLERR for _, event in poll.poll(0)):
        os.dup2(os.open(os.devnull, os.O_WRONLY), output)  # else Python complains of unwritten text
        sys.exit(128 + signal.SIGPIPE)


def explained(error: BaseException) -> str:
    """The error, the file it was about and a remedy; the traceback goes to a file."""
    about = file_of(error)
    where = f" (at {about})" if about else ""
    said = _brief(error, 300)
    if isinstance(error, MemoryError):
        return f"{said or 'out of memory: choose smaller pictures or fewer points'}{where}; {_report(error)}"
    return f"unexpected {type(error).__name__}{where}: {said or 'no message'}; please report it: {_report(error)}"


def file_of(error: BaseException) -> Path | None:
    """The file or folder that the innermost function of ours was at work on."""
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        if frame.f_globals.get("__name__", "").startswith(OURS):
            paths = [value for value in frame.f_locals.values() if isinstance(value, Path)]
            if paths:
                return paths[0]
    return None


def _report(error: BaseException) -> str:
    """Write the traceback to a file of its own; where it is."""
    command = shlex.join(["novags", *sys.argv[1:]])
    try:
        handle, name = tempfile.mkstemp(prefix="novags-traceback-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="replace") as file:
            file.write(f"{command}\npython {sys.version}\n\n{''.join(traceback.format_exception(error))}")
    except OSError:  # the disk is full, for example
        return "NOVAGS_TRACEBACK=1 before the same command shows the traceback"
    return f"the traceback is in {name}"


def _check_words(words: list[str]) -> None:
    """Refuse paths that are not UTF-8 before any work: the libraries that write images cannot open them.

    So are words that a terminal would obey when they are shown: control characters, and characters that turn the
    direction of writing.
    """
    for word in words:
        if any(ord(c) < 32 or 127 <= ord(c) < 160 or c in TURNING for c in word):
            raise ValueError(f"{word!a:.80} holds control characters: rename that file or folder")
        if any("\ud800" <= c <= "\udfff" for c in word):
            raise ValueError(f"{word!r} is not valid UTF-8: rename that file or folder")


def _say(text: str, code: int) -> int:
    """Say it, importing nothing: an interruption can leave numpy half loaded, which fails once more when asked for."""
    print(f"novags: {text}", file=sys.stderr)
    return code


def _brief(found: object, length: int) -> str:
    from sensor_model.files.reading import brief  # numpy comes with it: --help must not wait for that

    return brief(NAME.sub(lambda match: f"{match[0][:60]}...", str(found)), length)
