"""JSON files: read, and checked against the shape that their readers rely on, so that an edit by hand costs one line.

Where several readers want the same file, and its hash, `read_once` has it opened once for all of them.

A shape is
    str, bool, dict, list, None   a value of that type
    int, float                    a whole number below 2**63; a finite number, in floating point
    Numbers(3, 3)                 finite numbers in rows of that size
    {"a": shape, "b?": shape}     an object with these entries; "?" marks optional ones; others are left alone
    {"*": shape}                  an object whose entries all have the shape
    [shape]                       a list of any length
    (shape, shape)                any of these

Why no library checks them. msgspec 0.22 and pydantic 2.14 were tried on these shapes. Both read equal keys and numbers
beyond 2**64 without a word and let 1,000 and 200 levels pass, so that `parse_json` would stay. msgspec names neither
what stands there nor, in an object of any keys, where: "Expected `str`, got `int` - at `$.c[...]`". pydantic says both,
and with it `check_shape` passes its tests, but takes 62 lines as it does here, 10 MB, and .4 s of every start. They are
faster: 72,000 numbers take .1 s, here .4 s.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sensor_model.files.door import TEXT, as_text, opened, stamp_of
from sensor_model.files.reading import brief, reading

DEPTH = 64  # of lists and objects in each other; deeper ones exhaust any code that walks through them
WHOLE = 2**64  # whole numbers stay below it, as in every other language
Shape = Any
_WORDS: dict[Any, str] = {
    str: "text", bool: "true or false", int: "a whole number", float: "a finite number", dict: "an object",
    list: "a list", None: "null",
}  # fmt: skip


class Numbers:
    """Finite numbers in nested lists of a fixed size."""

    def __init__(self, *size: int) -> None:
        self.size = size


@dataclass(frozen=True)
class Read:
    """A JSON file in its state when it was opened.

    Attributes:
        value: Its content. All readers share it, so none changes it.
        hash: blake2b of its bytes.
        stamp: As `stamp_of` gave it.
    """

    value: Any
    hash: bytes
    stamp: tuple[int, ...]


Reads = dict[str, Read]  # by absolute path

_reads: ContextVar[Reads | None] = ContextVar("reads", default=None)


@contextmanager
def read_once(reads: Reads) -> Iterator[Reads]:
    """While the block runs, a JSON file that `reads` holds is not opened again, and one that is opened is held there.

    So the same bytes are checked, hashed and used, whoever writes to the file meanwhile.
    """
    token = _reads.set(reads)
    try:
        yield reads
    finally:
        _reads.reset(token)


def read_already(path: Path) -> Read | None:
    """The content of a file read in the running block of `read_once`; None: nothing."""
    reads = _reads.get()
    return None if reads is None else reads.get(os.path.abspath(path))


def read_record(path: Path, shape: Shape = dict, remedy: str = "correct it or put the original back") -> Any:
    """The content of a JSON file.

    Args:
        path: The file.
        shape: The shape it must have.
        remedy: What the user can do about a file that does not.

    Raises:
        ValueError: If the file is unreadable, not JSON or of another shape; names the file and the place in it.
    """
    value = read_json(path, remedy)
    check_shape(value, shape, f"{path}", remedy)
    return value


def read_json(
    path: Path, remedy: str = "correct it or put the original back", *, most: int = TEXT, infinite: bool = False
) -> Any:
    """The content of a JSON file of any shape; errors as for `read_record`.

    Args:
        path: The file.
        remedy: What the user can do about a file that cannot be read.
        most: Bytes that it may have.
        infinite: Let Infinity and NaN pass, as `parse_json`.
    """
    return read_whole(path, remedy, most=most, infinite=infinite).value


def read_whole(
    path: Path, remedy: str = "correct it or put the original back", *, most: int = TEXT, infinite: bool = False
) -> Read:
    """The content of a JSON file with its hash; arguments and errors as for `read_json`."""
    if (known := read_already(path)) is not None:
        return known
    try:
        with opened(path, most=most) as file:
            stamp, content = stamp_of(file.fileno()), file.read()
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror or error}") from error
    text = as_text(content, path)
    found = Read(parse_json(text, f"{path}", remedy, infinite=infinite), hashlib.blake2b(content).digest(), stamp)
    if (reads := _reads.get()) is not None:
        reads[os.path.abspath(path)] = found
    return found


def parse_json(
    text: str, where: str, remedy: str = "correct it or put the original back", *, infinite: bool = False
) -> Any:
    """A value from JSON text, refusing values that readers go wrong on: see `DEPTH`, `WHOLE`; NaN, infinity, equal
    keys.

    Args:
        text: The JSON.
        where: The file, or the place in it, for messages.
        remedy: What the user can do.
        infinite: Let Infinity and NaN pass, which are not JSON: for files of programs that are known to write them.

    Raises:
        ValueError: If it is not JSON, or one of these is in it; names `where`.
    """
    with reading(where, remedy):
        try:
            constant = float if infinite else _no_constant
            value = json.loads(
                text, parse_int=_whole, parse_float=_finite, parse_constant=constant, object_pairs_hook=_unique
            )
        except json.JSONDecodeError as error:
            raise ValueError(f"{where} is not valid JSON ({brief(error)}); {remedy}") from error
        check_depth(value)
    return value


def check_depth(value: Any) -> None:
    """Refuse lists and objects in each other beyond `DEPTH`.

    Raises:
        ValueError: If there are more.
    """
    level = [value] if isinstance(value, list | dict) else []
    for _ in range(DEPTH):
        parts = (part for outer in level for part in (outer.values() if isinstance(outer, dict) else outer))
        level = [part for part in parts if isinstance(part, list | dict)]
        if not level:
            return
    raise ValueError(f"it is nested more than {DEPTH} deep")


def _whole(digits: str) -> int:
    if len(digits) < 20 or (len(digits) < 22 and abs(int(digits)) < WHOLE):
        return int(digits)
    raise ValueError(f"whole numbers must be below 2**64, got one of {len(digits)} digits ({digits[:12]}...)")


def _finite(digits: str) -> float:
    value = float(digits)
    if math.isinf(value):
        raise ValueError(f"numbers must be below 1.8e308, got {digits[:40]}")
    return value


def _no_constant(name: str) -> Any:
    raise ValueError(f"numbers must be finite, got {name}")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{brief(twice, 60)!r} stands twice in one object")
    return found


def check_shape(value: Any, shape: Shape, where: str, remedy: str = "") -> None:
    """Refuse a value of another shape.

    Raises:
        ValueError: Naming the place of the first difference, the value required and the value found.
    """
    found = _difference(value, shape, "")
    if found is not None:
        place, rule, got = found
        raise ValueError(f"{where}: {place or 'its content'} must be {rule}, got {_shown(got)}"
                         + (f"; {remedy}" if remedy else ""))  # fmt: skip


def _difference(value: Any, shape: Shape, place: str) -> tuple[str, str, Any] | None:
    """Place, rule and value of the first difference."""
    if isinstance(shape, tuple):
        found = [_difference(value, option, place) for option in shape]
        # Of an object or a list that is nearly right, the place inside says more than a list of all options.
        inner = [f for f in found if f is not None and f[0] != place]
        return None if None in found else inner[0] if inner else (place, " or ".join(map(_words, shape)), value)
    if isinstance(shape, Numbers):
        return None if _has_size(value, shape.size) else (place, _words(shape), value)
    if isinstance(shape, dict | list) and not isinstance(value, type(shape)):
        return place, _words(type(shape)), value
    if isinstance(shape, list):
        inside = (_difference(part, shape[0], f"{place}[{i}]") for i, part in enumerate(value))
        return next((found for found in inside if found is not None), None)
    if isinstance(shape, dict):
        return _difference_inside(value, shape, f"{place}." if place else "")
    return None if _fits(value, shape) else (place, _words(shape), value)


def _difference_inside(value: dict[str, Any], shape: dict[str, Shape], prefix: str) -> tuple[str, str, Any] | None:
    for key, wanted in shape.items():
        name = key.removesuffix("?")
        keys = list(value) if key == "*" else [name]
        if key == name != "*" and name not in value:
            return prefix + name, "there", _Missing()
        for each in keys:
            found = _difference(value[each], wanted, prefix + each) if each in value else None
            if found is not None:
                return found
    return None


def _fits(value: Any, kind: Any) -> bool:
    if kind is None:
        return value is None
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63
    if kind is float:
        # int: json reads whole numbers of any length, and 10**400 does not fit a float
        whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) < 10**300
        return whole or (isinstance(value, float) and math.isfinite(value))
    return isinstance(value, kind)


def _has_size(value: Any, size: tuple[int, ...]) -> bool:
    if not size:
        return _fits(value, float)
    return isinstance(value, list) and len(value) == size[0] and all(_has_size(part, size[1:]) for part in value)


class _Missing:
    pass


def _words(shape: Shape) -> str:
    if isinstance(shape, Numbers):
        return f"{' x '.join(map(str, shape.size))} finite numbers"
    if isinstance(shape, tuple):
        return " or ".join(map(_words, shape))
    return _WORDS[type(shape) if isinstance(shape, dict | list) else shape]


def _shown(value: Any) -> str:
    if isinstance(value, _Missing):
        return "nothing"
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 10**30:
        return "a number of more than 30 digits"  # whose text can be refused itself
    try:
        text = json.dumps(value, default=str)
    except (RecursionError, ValueError):
        return "something too large to show"
    return text if len(text) <= 60 else f"{text[:57]}..."
