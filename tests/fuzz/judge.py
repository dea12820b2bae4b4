"""What a case did, and whether any case may do it."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

SECONDS, BYTES = 20.0, 2 << 30
LONGEST = 2000  # characters of a message
MEMORY = ("bad_alloc", "Unable to allocate", "Cannot allocate", "not enough memory", "DefaultCPUAllocator")
ROOT = Path(__file__).resolve().parents[2]
FRAME = re.compile(r'File "([^"]+)", line (\d+),? in (\S+)')


@dataclass(frozen=True)
class Limits:
    """What one case may take."""

    seconds: float = SECONDS
    bytes: int = BYTES


@dataclass(frozen=True)
class Finding:
    """A case that did what none may.

    Attributes:
        reader: Its reader, or its command.
        case: Its number.
        file: What was damaged, and how.
        kind: "crash", "hang", "memory", "exception", "warning", "message" or "wrong"; of commands also "exit",
            "control", "overwritten" and "executed".
        detail: What happened, in a line.
        place: Where in the project's code, as far as known.
    """

    reader: str
    case: int
    file: str
    kind: str
    detail: str
    place: str

    @property
    def signature(self) -> str:
        """The same for findings that have one cause, as a rule."""
        return f"{self.kind} {re.sub(r'[0-9]+', '', self.detail)[:60] if not self.place else self.place}"


@dataclass(frozen=True)
class Outcome:
    """What a call did.

    Attributes:
        fault: Kind, detail and place of what it did wrong; None if it did as documented.
        refused: The documented error, in words; None if there was none.
        value: What it returned.
    """

    fault: tuple[str, str, str] | None = None
    refused: str | None = None
    value: object = None


def judged(read: Callable[[], object]) -> Outcome:
    """Call it."""
    try:
        return Outcome(value=read())
    except (ValueError, OSError) as error:
        text = str(error)
        if _is_memory(error):
            return Outcome(("memory", _line(error), _place(error)))
        if isinstance(error, OSError) and error.errno is not None:
            return Outcome(refused=text)  # the system's own words
        if not text.strip() or len(text) > LONGEST:
            said = f"{type(error).__name__} of {len(text)} characters: {text[:80]!r}"
            return Outcome(("message", said, _place(error)))
        return Outcome(refused=text)
    except MemoryError as error:
        return Outcome(("memory", _line(error), _place(error)))
    except Exception as error:
        kind = "memory" if _is_memory(error) else "warning" if isinstance(error, Warning) else "exception"
        return Outcome((kind, _line(error), _place(error)))
    except BaseException as error:
        return Outcome(("exception", _line(error), _place(error)))


def _is_memory(error: BaseException | None) -> bool:
    seen = 0
    while error is not None and seen < 20:
        if isinstance(error, MemoryError) or any(words in str(error) for words in MEMORY):
            return True
        error, seen = error.__cause__ or error.__context__, seen + 1
    return False


def _line(error: BaseException) -> str:
    try:
        text = str(error)
    except Exception as inner:
        text = f"(its text cannot be made: {inner!r})"
    return f"{type(error).__name__}: {' '.join(text.split())}"[:300].encode("utf-8", "replace").decode()


def _place(error: BaseException) -> str:
    """The innermost line of the project itself."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if is_own(f.filename)]
    return f"{Path(own[-1].filename).relative_to(ROOT)}:{own[-1].lineno} {own[-1].name}" if own else ""


def places_in(text: str) -> list[str]:
    """The project's own lines in a printed traceback, in its order."""
    return [f"{Path(m[1]).relative_to(ROOT)}:{m[2]} {m[3]}" for m in FRAME.finditer(text) if is_own(m[1])]


def is_own(file: str) -> bool:
    """Whether it is of the project, and not of this harness."""
    return file.startswith(str(ROOT)) and "/tests/fuzz/" not in file and "/.venv/" not in file


def jsonable(finding: Finding) -> dict[str, Any]:
    """For a record."""
    return asdict(finding)
