"""Names of the views of a set, for any names of their files.

A view's name is the stem of all its files in a set, a capture and a run, and a line of train_list.txt. Any file has
one: its own stem where that is safe and nobody else's, else something close to it.
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path

NAME_BYTES = 200  # in UTF-8: file systems hold 255, and suffixes and marks of unfinished files come on top
UNSAFE = ("Cc", "Cs", "Zl", "Zp")  # Unicode: control characters, half characters, separators of lines and paragraphs


def file_of(name: str) -> str:
    """The image file of a view; views are sorted by it, as other loaders list images and hold out every 8th."""
    return f"{name}.png"


def numbered(count: int) -> list[str]:
    """Names of so many views: their numbers with as many digits as keep them in order, four at least."""
    digits = max(4, len(str(count - 1)))
    return [f"{i:0{digits}d}" for i in range(count)]


def safe_name(text: str) -> str:
    """`text` as a name: on one line, visible (no leading dot), without slashes, at most `NAME_BYTES` long."""
    clean = "".join("_" if c in "/\\" or unicodedata.category(c) in UNSAFE else c for c in text)
    if clean[:1] in ("", ".") or clean[0].isspace():
        clean = f"_{clean[1:]}"
    return _cut(clean, NAME_BYTES)


def view_names(files: Sequence[Path]) -> list[str]:
    """A name for each file, safe and different from all others even where upper and lower case count alike.

    Stems where they differ; else paths below the folder that all files share, joined by "_"; names still alike are
    numbered in the order of the paths (a, a~2).

    Args:
        files: Different files.
    """
    names = [safe_name(file.stem) for file in files]
    if len({_folded(name) for name in names}) < len(names):
        shared = os.path.commonpath([os.path.abspath(file.parent) for file in files])
        below = [os.path.relpath(os.path.abspath(file), shared) for file in files]  # whole paths differ by machine
        names = [safe_name(os.path.splitext(path)[0]) for path in below]
    taken: set[str] = set()
    for i in sorted(range(len(files)), key=lambda i: str(files[i])):
        base, count = names[i], 1
        while _folded(names[i]) in taken:
            count += 1
            mark = f"~{count}"
            names[i] = _cut(base, NAME_BYTES - len(mark)) + mark
        taken.add(_folded(names[i]))
    return names


def check_names(names: Sequence[str], count: int) -> None:
    """Refuse names that the files of a set cannot have.

    Raises:
        ValueError: If they are not one for each of `count` cameras, safe, different and sorted as files.
    """
    if len(names) != count:
        raise ValueError(f"names must be one per camera, got {len(names)} names for {count} cameras")
    if unsafe := [name for name in names if safe_name(name) != name]:
        raise ValueError(f"names must be safe as file names, got {unsafe[0]!r}: {safe_name(unsafe[0])!r} would be")
    files = [file_of(name) for name in names]
    if files != sorted(set(files)):
        raise ValueError(f"names must be different and sorted as file names (name.png), got {list(names)[:3]} ...: "
                         "sort names and cameras together")  # fmt: skip


def check_order(names: Sequence[str], others: Sequence[str], what: str, whose: str) -> None:
    """Refuse to pair by order where names have two: a9 is behind a10 by its letters, and before it by its number.

    Args:
        names: In the order of their letters.
        others: As many, in the order of theirs.
        what: The folder of the others, for the message.
        whose: What has the names.

    Raises:
        ValueError: If the two orders pair differently.
    """
    by_numbers = dict(zip(sorted(names, key=_numbers_counted), sorted(others, key=_numbers_counted), strict=True))
    for name, other in zip(names, others, strict=True):
        if by_numbers[name] != other:
            raise ValueError(
                f"{what}: the order of the names does not say which picture belongs to {whose} {name}: {other} by "
                f"their letters, {by_numbers[name]} by the numbers in them; give both the same names"
            )


def _numbers_counted(name: str) -> list[str | int]:
    return [int(part) if k % 2 else part for k, part in enumerate(re.split(r"([0-9]+)", name))]


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _cut(name: str, size: int) -> str:
    return name.encode()[:size].decode(errors="ignore")
