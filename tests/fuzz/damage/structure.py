"""Damage that keeps a file's outer form: lengths and check sums fit, so that what lies behind them is reached."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
import zlib
from copy import deepcopy
from random import Random
from typing import Any
from xml.etree import ElementTree

DEEP = 3000  # nested lists: more than Python's recursion limit
ODD = (None, True, False, "", "x", "nan", "0", "../..", "a\nb", "\ud800", "é" * 300, 0, -1, 1, 0.5, -0.0, 1e300,
       1e-320, 2**31, 2**63, 2**64, 10**9, [], {}, [[]], [None], {"": None}, [1, 2, 3], "/dev/null",
       "images")  # fmt: skip
RAW = ("NaN", "Infinity", "-Infinity", "1e999", "1" + "0" * 400, "-" + "9" * 5000, "[" * DEEP + "]" * DEEP,
       '{"a":' * DEEP + "1" + "}" * DEEP)  # fmt: skip


def json_value(content: bytes, rng: Random) -> bytes:
    """Replace, remove, copy, rename or wrap one value of a JSON document (of one line of it, if that is its form)."""
    lines = [content]
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        lines = content.splitlines(keepends=True)
        if not lines:
            return content
        place = rng.randrange(len(lines))
        try:
            document = json.loads(lines[place])
        except (ValueError, RecursionError):
            return content
    else:
        place = 0
    raw = rng.choice(RAW)
    holder = [document]
    try:
        _change(holder, rng)
        text = json.dumps(holder[0] if holder else None, indent=1 if len(lines) == 1 else None)
    except (RecursionError, ValueError):
        return content
    lines[place] = text.replace('"@raw@"', raw).encode() + (b"\n" if len(lines) > 1 else b"")
    return b"".join(lines)


def _places(node: Any, found: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    for key in node if isinstance(node, dict) else range(len(node)):
        found.append((node, key))
        if isinstance(node[key], (dict, list)):
            _places(node[key], found)
    return found


def _change(document: Any, rng: Random) -> None:
    places = _places(document, [])
    holder, key = rng.choice(places)
    what = rng.randrange(9)
    if what <= 2:
        holder[key] = rng.choice(ODD)
    elif what == 3:
        holder[key] = "@raw@"
    elif what == 4:
        del holder[key]
    elif what == 5:
        other, name = rng.choice(places)
        if name in other if isinstance(other, dict) else name < len(other):
            holder[key] = json.loads(json.dumps(other[name]))
    elif what == 6:
        holder[key] = [holder[key]] if rng.random() < 0.5 else str(holder[key])
    elif isinstance(holder, dict):
        holder[rng.choice(("", "x", str(key) + "s", str(key).upper()))] = holder.pop(key)
    else:
        holder.insert(key, holder[key])


TOML = ("nan", "inf", "-inf", "-1", "0", "1e308", "1e999", "1" + "0" * 400, '"x"', '""', '"nan"', "true", "[]", "{}",
        "[[]]", "[1, 'a']", "{a = 1}", "1979-05-27", "07:32:00", "0x10", "1_0", "'''\na'''",
        "[" * DEEP + "]" * DEEP)  # fmt: skip


def toml_line(content: bytes, rng: Random) -> bytes:
    lines = content.decode("utf-8", "surrogateescape").splitlines()
    if not lines:
        return content
    i = rng.randrange(len(lines))
    key, equals, value = lines[i].partition("=")
    what = rng.randrange(5)
    if not equals or what == 0:
        lines[i] = rng.choice(
            ("", "[x]", "[[x]]", "[optics]", "[stacks]", "[camera]", lines[i] + ".y", "]", lines[i].upper())
        )
    elif what == 1:
        lines[i] = f"{rng.choice(('x', key.strip() + '.a', key.strip() + 's', ''))} ={value}"
    else:
        lines[i] = f"{key}= {rng.choice(TOML)}"
    return "\n".join(lines).encode("utf-8", "surrogateescape")


PLUGINS: list[str] = []  # filled by the reader of scenes
TAGS = ("shape", "bsdf", "texture", "emitter", "sensor", "film", "sampler", "rfilter", "integrator", "medium", "phase",
        "volume", "spectrum", "rgb", "float", "integer", "string", "boolean", "point", "vector", "transform", "lookat",
        "rotate", "scale", "matrix", "ref", "default", "include", "path", "alias", "translate")  # fmt: skip
VALUES = ("0", "-1", "nan", "inf", "1e38", "1e999", "", "x", "1,2", "0,0,0", "1 2 3 4", "1e-40", "4294967296", "$x",
          "m.ply", "t.png", "e.exr", "true", "9" * 400, "1,1,1", "0,0,1", "ball")  # fmt: skip


def xml_element(content: bytes, rng: Random) -> bytes:
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError):
        return content
    pairs = [(parent, child) for parent in root.iter() for child in parent]
    if not pairs:
        return content
    parent, child = rng.choice(pairs)
    what = rng.randrange(8)
    if what == 0:
        parent.remove(child)
    elif what == 1:
        rng.choice(pairs)[0].append(deepcopy(child))  # itself would make a circle
    elif what == 2 and PLUGINS:
        child.set("type", rng.choice(PLUGINS))
    elif what == 3:
        child.tag = rng.choice(TAGS)
    elif what == 4 and PLUGINS:
        made = {"type": rng.choice(PLUGINS), "name": rng.choice([e.get("name", "a") for e in root.iter()])}
        ElementTree.SubElement(child if rng.random() < 0.7 else parent, rng.choice(TAGS[:13]), made)
    elif child.attrib and what == 5:
        del child.attrib[rng.choice(list(child.attrib))]
    elif child.attrib:
        child.set(rng.choice(list(child.attrib)), rng.choice(VALUES))
    return ElementTree.tostring(root)


def png_chunk(content: bytes, rng: Random) -> bytes:
    """Change one chunk, and give it the length and the sum that fit."""
    chunks, at = [], 8
    while at + 12 <= len(content):
        length = struct.unpack(">I", content[at : at + 4])[0]
        chunks.append([content[at + 4 : at + 8], content[at + 8 : at + 8 + length]])
        at += 12 + length
    if not chunks:
        return content
    i = rng.randrange(len(chunks)) if rng.random() < 0.5 else 0
    what = rng.randrange(5)
    if what == 0:
        chunks[i][1] = _patched(chunks[i][1], rng)
    elif what == 1:
        del chunks[i]
    elif what == 2:
        chunks.insert(rng.randrange(len(chunks)), chunks[i])
    elif what == 3:
        try:
            pixels = zlib.decompress(b"".join(data for kind, data in chunks if kind == b"IDAT"))
        except zlib.error:
            return content
        chunks = [c for c in chunks if c[0] not in (b"IDAT", b"IEND")]
        chunks += [[b"IDAT", zlib.compress(_patched(pixels, rng)[: rng.randrange(len(pixels) + 1)])], [b"IEND", b""]]
    else:
        head = list(struct.unpack(">IIBBBBB", chunks[0][1][:13].ljust(13, b"\0")))
        place = rng.randrange(7)
        big = rng.choice((0, 1, 3, 65535, 2**31 - 1, 2**31, 2**32 - 1, 30000))
        head[place] = big if place < 2 else rng.choice((0, 1, 2, 3, 4, 6, 7, 8, 16, 32, 255))
        chunks[0][1] = struct.pack(">IIBBBBB", *head)
    body = b"".join(struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks)
    return content[:8] + body


def _patched(data: bytes, rng: Random) -> bytes:
    if not data:
        return rng.randbytes(4)
    at = rng.randrange(len(data))
    patch = rng.choice((b"\0", b"\xff", b"\0\0\0\0", b"\xff\xff\xff\xff", rng.randbytes(3)))
    return data[:at] + patch + data[at + len(patch) :]


def safetensors_head(content: bytes, rng: Random) -> bytes:
    length = struct.unpack("<Q", content[:8].ljust(8, b"\0"))[0]
    if length > len(content):
        return content
    head, body = content[8 : 8 + length], content[8 + length :]
    if rng.random() < 0.3:  # the state of a fit is JSON in a text of the JSON head
        try:
            whole = json.loads(head)
            whole["__metadata__"]["state"] = json_value(whole["__metadata__"]["state"].encode(), rng).decode()
            head = json.dumps(whole).encode()
        except (KeyError, ValueError, TypeError, AttributeError, RecursionError):
            return content
    else:
        head = json_value(head, rng)
    return struct.pack("<Q", len(head)) + head + body


def zip_member(content: bytes, rng: Random) -> bytes:
    """Change one file of an archive; torch's checkpoints are such."""
    from tests.fuzz.damage import mutate

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    # What `zipfile` raises where an earlier change has damaged the archive itself, which is a case too: it stays so.
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError, EOFError, zlib.error, struct.error):
        return content
    if not members:
        return content
    name = rng.choice(list(members))
    members[name] = rng.choice(mutate.BYTES)(members[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for each, data in members.items():
            archive.writestr(each, data)
    return out.getvalue()


def ply_head(content: bytes, rng: Random) -> bytes:
    from tests.fuzz.damage import mutate

    head, end, body = content.partition(b"end_header\n")
    return rng.choice(mutate.TEXTUAL)(head, rng) + end + body


WORDS = ("", "-", "--", "--x", "-1", "\ud800", "a\nb", "=", ":", "nan", "1e999", "9" * 5000, "None", "/", "..", "\0",
         "é", "known:", "x=nova:", "x=nova:fit=1", "vggt:checkpoint=/", "🦉" * 99)  # fmt: skip


def arguments(content: bytes, rng: Random) -> bytes:
    """A command line, a JSON list of words."""
    try:
        words = json.loads(content)
    except ValueError:
        return content
    if not isinstance(words, list) or not words:
        return content
    i, j = rng.randrange(len(words)), rng.randrange(len(words))
    what = rng.randrange(6)
    if what == 0:
        del words[i]
    elif what == 1:
        words.insert(j, words[i])
    elif what == 2:
        words[i], words[j] = words[j], words[i]
    elif what == 3:
        words[i] = re.sub(r"[-\d.]+", lambda m: rng.choice(VALUES), str(words[i]), count=1)
    elif what == 4:
        words[i] = rng.choice(WORDS)
    else:
        word = str(words[i])
        at = rng.randrange(len(word) + 1)
        words[i] = word[:at] + rng.choice(("=", ",", ":", ";", ".", "-", "0", " ", "\t", "x")) + word[at:]
    return json.dumps(words).encode()


FOR = {
    ".json": json_value, ".gltf": json_value, ".jsonl": json_value, ".toml": toml_line, ".xml": xml_element,
    ".png": png_chunk, ".argv": arguments, ".safetensors": safetensors_head, ".pt": zip_member, ".ply": ply_head,
}  # fmt: skip
