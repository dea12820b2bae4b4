"""Odd texts: byte-order marks, other encodings, deep nesting, numbers of 400 digits, names that a terminal obeys.

The first three kinds leave the meaning of a file as it is: a reader gives what it gave, or refuses.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from random import Random
from typing import Any

from tests.fuzz.damage import mutate

DEPTH = 100_000
NUMBERS = ("9" * 400, "-" + "9" * 400, "0." + "0" * 400 + "1", "1e999", "-1e999", "NaN", "-NaN", "Infinity",
           "-Infinity", "-0", "-0.0", "1e-999", "9" * 5000, "18446744073709551616", "inf", "nan")  # fmt: skip
NAMES = ("\x1b[31mred\x1b[0m", "\x1b]0;title\x07", "a\nb", "a\r\nb", "\u202egnp.exe", "\u2066x\u2069", "\x9b31m",
         "x" * 5000, "é" * 5000, "\x08\x08", "a\tb", "=1+cmd|' /C calc'!A0", "\u2028", "<script>alert(1)</script>",
         "%s%n", "a" * 256, "\ud800", "[red]x[/red]", "../" * 2000)  # fmt: skip
MARK = '"@@odd@@"'


def byte_order_mark(content: bytes, rng: Random) -> bytes:
    return b"\xef\xbb\xbf" + content


def windows_lines(content: bytes, rng: Random) -> bytes:
    return content.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n")


def other_order(content: bytes, rng: Random) -> bytes:
    """Keys of JSON objects in another order."""
    return _each_document(content, lambda value: json.dumps(_shuffled(value, rng)))


def utf16(content: bytes, rng: Random) -> bytes:
    return content.decode("utf-8", "replace").encode(rng.choice(("utf-16", "utf-16-le", "utf-16-be", "utf-32")))


def latin1(content: bytes, rng: Random) -> bytes:
    return _inserted(content, rng.choice((b"\xe9", b"\xff", b"\x80", b"\xed\xa0\x80", b"\xc0\xaf")), rng)


def nul(content: bytes, rng: Random) -> bytes:
    return _inserted(content, rng.choice((b"\0", b"\0" * 5000, b"\x1a")), rng)


def deep(content: bytes, rng: Random, suffix: str) -> bytes:
    """A value nested a hundred thousand times, or the whole text."""
    pairs = {".xml": ('<shape type="merge">', "</shape>"), ".toml": ("[", "]")}
    begin, end = pairs.get(suffix) or rng.choice((("[", "]"), ('{"a":', "}"), ('[{"a":', "}]")))
    closed = rng.random() < 0.8
    raw = begin * DEPTH + ("1" if suffix not in pairs else "") + (end * DEPTH if closed else "")
    if suffix == ".xml":
        return content.replace(b"</scene>", raw.encode() + b"</scene>")
    return raw.encode() if rng.random() < 0.3 and suffix != ".toml" else replaced(content, raw, rng, suffix)


def number(content: bytes, rng: Random, suffix: str) -> bytes:
    raw = rng.choice(NUMBERS)
    return replaced(content, raw.lower() if suffix == ".toml" else raw, rng, suffix, of=(int, float))


def name(content: bytes, rng: Random, suffix: str) -> bytes:
    odd = rng.choice(NAMES)
    quoted = suffix in (".json", ".jsonl", ".toml", ".safetensors")
    raw = json.dumps(odd, ensure_ascii=rng.random() < 0.5) if quoted else odd
    return replaced(content, raw, rng, suffix, of=(str,))


def twice(content: bytes, rng: Random, suffix: str) -> bytes:
    """A key with two values in one object, or a line of a text twice."""
    if suffix not in (".json", ".jsonl", ".safetensors"):
        lines = content.splitlines(keepends=True)
        return content + rng.choice(lines) if lines else content

    def doubled(value: Any) -> str:
        holders = [value, *_parts(value, [])]
        objects = [each for each in holders if isinstance(each, dict) and each]
        if not objects:
            return json.dumps(value)
        chosen = rng.choice(objects)
        key = rng.choice(list(chosen))
        inner = json.dumps(chosen)[:-1] + f", {json.dumps(key)}: {rng.choice(('0', 'null', json.dumps(chosen[key])))}}}"
        return json.dumps(value).replace(json.dumps(chosen), inner, 1)

    return _each_document(content, doubled)


def replaced(content: bytes, raw: str, rng: Random, suffix: str, of: tuple[type, ...] = (object,)) -> bytes:
    """One value of the text replaced by a raw text; of these types, if there are such."""
    patch = raw.encode("utf-8", "surrogatepass")
    if suffix in (".json", ".jsonl", ".safetensors"):
        marked = _each_document(content, lambda value: _marked(value, rng, of), rng)
        return marked.replace(MARK.encode(), patch)
    if suffix == ".toml":
        found = list(re.finditer(rb"=[^\n]*", content))
        place = rng.choice(found).span() if found else (0, 0)
        return content[: place[0]] + b"= " + patch + content[place[1] :]
    pattern = rb'"[^"\n]*"' if suffix == ".xml" else mutate.NUMBER if int in of else rb"[^\s,:]+"
    found = list(re.finditer(pattern, content[:4096]))
    if not found:
        return content
    start, stop = rng.choice(found).span()
    quote = b'"' if suffix == ".xml" else b""
    return content[:start] + quote + patch.replace(b'"', b"'") + quote + content[stop:]


def _inserted(content: bytes, what: bytes, rng: Random) -> bytes:
    """Often behind a quotation mark, so that it stands in a name."""
    marks = [match.end() for match in re.finditer(b'"', content[:1_000_000])]
    at = rng.choice(marks) if marks and rng.random() < 0.7 else rng.randrange(len(content) + 1)
    return content[:at] + what + content[at:]


def _each_document(content: bytes, change: Callable[[Any], str], rng: Random | None = None) -> bytes:
    """A JSON text, or a line of JSON lines, changed; all lines if there is no `rng`. Others stay as they are."""
    try:
        return change(json.loads(content)).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):
        pass
    lines = content.splitlines()
    for i in range(len(lines)) if rng is None else [rng.randrange(len(lines))] if lines else []:
        try:
            lines[i] = change(json.loads(lines[i])).encode("utf-8", "surrogatepass")
        except (ValueError, RecursionError):
            return content
    return b"".join(line + b"\n" for line in lines)


def _marked(value: Any, rng: Random, of: tuple[type, ...]) -> str:
    holder = [value]
    places = [(h, k) for h in [holder, *_parts(value, [])] for k in (h if isinstance(h, dict) else range(len(h)))]
    fitting = [(h, k) for h, k in places if isinstance(h[k], of) and not isinstance(h[k], bool)]
    chosen, key = rng.choice(fitting or places)
    if str in of and isinstance(chosen, dict) and rng.random() < 0.3:
        chosen[MARK[1:-1]] = chosen.pop(key)
    else:
        chosen[key] = MARK[1:-1]
    return json.dumps(holder[0])


def _parts(value: Any, found: list[Any]) -> list[Any]:
    for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        if isinstance(each, (dict, list)):
            found.append(each)
            _parts(each, found)
    return found


def _shuffled(value: Any, rng: Random) -> Any:
    if isinstance(value, dict):
        keys = list(value)
        rng.shuffle(keys)
        return {key: _shuffled(value[key], rng) for key in keys}
    return [_shuffled(each, rng) for each in value] if isinstance(value, list) else value


SAME: dict[str, Callable[[bytes, Random], bytes]] = {
    "byte-order mark": byte_order_mark, "CRLF": windows_lines, "other order": other_order,
}  # fmt: skip
OTHER: dict[str, Callable[..., bytes]] = {
    "UTF-16": utf16, "Latin-1": latin1, "NUL": nul, "deep": deep, "number": number, "name": name, "twice": twice,
}  # fmt: skip
OF_VALUES = ("deep", "number", "name", "twice")
TEXT = (*mutate.TEXT, ".csv", ".ply", ".safetensors")


def suits(kind: str, file: str) -> bool:
    """Whether a file can be changed so; keys have an order in JSON alone."""
    suffix = mutate.suffix(file)
    if suffix == ".safetensors":
        return kind in OF_VALUES
    if kind == "other order":
        return suffix in (".json", ".jsonl")
    return suffix in TEXT and (kind != "CRLF" or suffix != ".ply")


def changed(kind: str, file: str, content: bytes, rng: Random) -> bytes:
    """The file with a text of this kind."""
    suffix = mutate.suffix(file)
    if suffix == ".safetensors":
        length = struct.unpack("<Q", content[:8].ljust(8, b"\0"))[0]
        head = OTHER[kind](content[8 : 8 + length], rng, suffix)
        return struct.pack("<Q", len(head)) + head + content[8 + length :]
    if kind in OF_VALUES:
        return OTHER[kind](content, rng, suffix)
    return {**SAME, **OTHER}[kind](content, rng)
