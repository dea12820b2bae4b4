"""Files that people bring: any fault of one becomes one line that names it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches

WORDS: dict[type[Exception], str] = {
    RecursionError: "is nested too deeply",
    OverflowError: "holds a number that is too large",
    UnicodeDecodeError: "is not UTF-8 text",
}
PLY_TYPES = {  # words of a PLY header for numbers, as numpy writes them without their byte order
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "uchar": "u1", "uint8": "u1", "char": "i1",
    "int8": "i1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4",
    "uint": "u4", "uint32": "u4",
}  # fmt: skip


def brief(found: object, length: int = 300) -> str:
    """Content of a file, or a library's words on it, as one printable line of at most `length` characters.

    Others, such as ESC, are shown as Python writes them: a terminal would obey them.
    """
    if isinstance(found, Exception) and found.args and isinstance(found.args[0], bytes):  # LibRaw's words
        found = found.args[0].decode("ascii", "replace")
    text = printable(" ".join(str(found).split()))
    return text if len(text) <= length else f"{text[: length - 4]} ..."


def printable(text: str) -> str:
    """The text with characters that cannot be printed written out, as a program in Python would write them."""
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def some(names: Sequence[str], most: int = 3) -> str:
    """The first `most` names of a list for a message: one line, for any names."""
    shown = [brief(name if name.isprintable() else repr(name), 200) for name in names[:most]]
    return ", ".join([*shown, "..."] if len(names) > most else shown)


def meant(name: str, known: Iterable[str]) -> str:
    """What a message says of the nearest of the known names, before it lists them all; nothing if none is near."""
    near = get_close_matches(name, list(known), 1)
    return f"did you mean {near[0]!r}? " if near else ""


@contextmanager
def reading(path: str | os.PathLike[str], remedy: str = "correct it or put the original back") -> Iterator[None]:
    """Around everything that makes sense of a file's content: any failure becomes a ValueError that names the file.

    Args:
        path: The file; a ValueError that names it already passes unchanged.
        remedy: What the user can do.

    Raises:
        ValueError: For every exception but OSError and MemoryError, which are not the content's fault.
    """
    try:
        yield
    except (OSError, MemoryError):
        raise
    except Exception as error:
        if isinstance(error, ValueError) and str(path) in str(error):
            raise
        said = [words for kind, words in WORDS.items() if isinstance(error, kind)]
        if isinstance(error, ValueError) and not said:
            raise ValueError(f"{path}: {brief(error)}; {remedy}") from error
        what = said[0] if said else f"is damaged ({type(error).__name__}: {brief(error)})"
        raise ValueError(f"{path} {what}; {remedy}") from error
