"""Mesh files whose numbers contradict each other: Mitsuba would read memory that is not theirs, or reserve it all."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sensor_model.files.door import opened
from sensor_model.files.reading import PLY_TYPES
from simscenes.loading.contents import surfaces_in
from simscenes.sets.pictures.whole import DEFLATE

PLY_BYTES = {word: np.dtype(kind).itemsize for word, kind in PLY_TYPES.items()}
MAX_HEADER = 1 << 16  # bytes of a PLY or `serialized` file that are looked at


def check_mesh_file(path: Path) -> None:
    """Refuse a PLY or Mitsuba `serialized` file that announces more than it can hold; other files pass.

    Raises:
        ValueError: If it does.
    """
    kind = path.suffix.lower()
    if kind not in (".ply", ".serialized"):
        return
    size = path.stat().st_size
    with opened(path) as file:
        start = file.read(MAX_HEADER)
    least = _ply_bytes(start) if kind == ".ply" else _serialized_bytes(start)
    most = size - max(start.find(b"end_header"), 0) if kind == ".ply" else DEFLATE * size
    if least > most:
        raise ValueError(f"mesh file {path} announces at least {least} bytes of vertices and faces, but has {size}: it "
                         "is cut short or damaged, get it again")  # fmt: skip


def _ply_bytes(start: bytes) -> int:
    """The fewest bytes that the elements of a PLY header can take; 0 for other text, which Mitsuba refuses itself."""
    total, count, binary = 0, 0, True
    for line in start.split(b"end_header", 1)[0].decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:2] == ["format", "ascii"]:
            binary = False
        elif len(words) == 3 and words[0] == "element":
            # Mitsuba reads "-1" as 2**64 - 1.
            count = int(words[2]) if words[2].isdecimal() and len(words[2]) < 20 else 2**64
        elif len(words) >= 3 and words[0] == "property":
            of = words[2] if words[1] == "list" else words[1]  # of a list at least the length is there
            total += count * (PLY_BYTES.get(of, 1) if binary else 2)  # a digit and a space
    return total


def _serialized_bytes(start: bytes) -> int:
    """The bytes of the first mesh of a `serialized` file; 0 if its head cannot be read, which Mitsuba refuses."""
    if len(start) < 4:
        return 0
    identifier, version = struct.unpack("<HH", start[:4])
    if identifier != 0x041C or version not in (3, 4):
        return 0
    head = _inflated(start[4:])
    try:
        if version == 4:
            head = head[:4] + head[head.index(b"\0", 4) + 1 :]  # the name
        flags, vertices, faces = struct.unpack("<IQQ", head[:20])
    except (ValueError, struct.error):
        return 0
    each = 8 if flags & 0x2000 else 4
    return int(vertices * 3 * each + faces * 3 * 4)


def _inflated(data: bytes) -> bytes:
    """The start of a zlib stream, up to where it is damaged: Mitsuba believes the counts before that."""
    stream, found = zlib.decompressobj(), b""
    try:
        for byte in data:  # one by one: an error takes data that the same call has already decompressed with it
            found += stream.decompress(bytes([byte]), MAX_HEADER - len(found))
            if len(found) >= MAX_HEADER or stream.eof:
                break
    except zlib.error:
        pass
    return found


def check_faces(params: Mapping[str, Any]) -> None:
    """Refuse a loaded scene with a mesh whose faces name vertices that it does not have.

    Args:
        params: The result of `parameters_in`.

    Raises:
        ValueError: If there is one.
    """
    for key in params:
        prefix, dot, name = key.rpartition(".")
        positions = f"{prefix}{dot}vertex_positions"
        if name != "faces" or positions not in params:
            continue
        corners, vertices = np.array(params[key]), len(params[positions]) // 3
        if corners.size and int(corners.max()) >= vertices:
            name = "without an id" if prefix.startswith("object_") else repr(prefix)
            raise ValueError(f"a mesh {name} has {vertices} vertices, but a face names vertex "
                             f"{int(corners.max())} (counted from 0): the file is damaged")  # fmt: skip


def check_texture_coordinates(scene: Any, mi: Any) -> None:
    """Refuse a loaded scene with a texture on a mesh that does not say where the texture lies.

    Mitsuba would take each triangle's own coordinates, and show pieces of the texture in wrong places.

    Raises:
        ValueError: If there is one.
    """
    placed: dict[Any, str] = {}  # the first texture of each material or lamp that has to be placed
    for shape in surfaces_in(scene, mi):
        if not shape.is_mesh() or shape.has_vertex_texcoords():
            continue
        for part in (shape.bsdf(), shape.emitter()):
            if part is not None and part not in placed:
                placed[part] = _placed_texture(mi.traverse(part))
            if part is not None and placed[part]:
                raise ValueError(f"the mesh {shape.id() or shape.class_name()!r} has no texture coordinates, and its "
                                 f"{placed[part]} is a texture that needs them: unwrap the mesh and export it with "
                                 "them (Blender: UV > Unwrap), or give it a colour instead")  # fmt: skip


def _placed_texture(params: Any) -> str:
    """The input of a material or lamp that is a texture and not the same everywhere; "" if there is none."""
    keys = set(params.keys())
    for name in sorted(key.removesuffix(".to_uv") for key in keys if key.endswith(".to_uv")):
        texels = np.array(params[f"{name}.data"]) if f"{name}.data" in keys else None  # a checkerboard has none
        if texels is None or (texels != texels[0, 0]).any():
            return name.rpartition(".")[2]
    return ""
