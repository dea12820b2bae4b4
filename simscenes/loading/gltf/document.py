"""The content of a glTF file: its objects, checked, and its arrays and pictures.

The container and the buffers are read by pygltflib. Its typed objects drop every key that they do not know, so that
nobody could say what was left out: the keys are looked at in the JSON itself. trimesh, which would give whole meshes,
reads sparse and normalised numbers as others (5.2), and has no lights.
"""

from __future__ import annotations

import base64
import os
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import cv2
import numpy as np
from numpy.typing import NDArray

from sensor_model.files.door import as_text, is_given, read_bytes, resolved
from sensor_model.files.records import parse_json
from simscenes.loading.gltf.allowed import check_content

MOST = 2 << 30  # bytes of a file
NUMBERS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
ITEMS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


@dataclass
class GltfDocument:
    """One file, with the files beside it that hold its buffers and pictures.

    Attributes:
        path: The file, links resolved.
        content: Its JSON.
        files: All files that belong to it, itself first.
    """

    path: Path
    content: dict[str, Any]
    files: tuple[Path, ...]
    _buffers: list[bytes] = field(repr=False)

    def all(self, kind: str) -> list[Any]:
        """The list of this name; empty where there is none."""
        return list(self.content.get(kind) or [])

    def one(self, kind: str, index: Any, where: str) -> Any:
        """An entry of a list.

        Raises:
            ValueError: If there is none of this number.
        """
        entries = self.all(kind)
        if type(index) is not int or not 0 <= index < len(entries):
            raise ValueError(f"{self.path}: {where} names number {index!r:.40} of {len(entries)} {kind}: it is damaged")
        return entries[index]

    def array(self, index: Any, where: str) -> NDArray[Any]:
        """The numbers of an accessor, [count, items]; normalised integers as floats.

        Raises:
            ValueError: If they do not lie in the buffer.
        """
        accessor = self.one("accessors", index, where)
        items, kind = ITEMS.get(accessor.get("type")), NUMBERS.get(accessor.get("componentType"))
        count = accessor.get("count")
        if items is None or kind is None or type(count) is not int or count < 1 or "bufferView" not in accessor:
            raise ValueError(f"{self.path}: {where}: the accessor {accessor!r:.200} is not understood")
        view = self.one("bufferViews", accessor["bufferView"], where)
        data = self.bytes_of(view, where)
        size = np.dtype(kind).itemsize * items
        step, start = view.get("byteStride") or size, accessor.get("byteOffset") or 0
        if start < 0 or step < size or start + (count - 1) * step + size > len(data):
            raise ValueError(f"{self.path}: {where}: {count} entries from byte {start} do not fit in {len(data)} bytes")
        rows = np.lib.stride_tricks.as_strided(
            np.frombuffer(data, np.uint8, offset=start), (count, size), (step, 1), writeable=False
        )
        found = np.ascontiguousarray(rows).view(kind)
        if accessor.get("normalized") and found.dtype.kind != "f":
            found = np.maximum(found / np.float32(np.iinfo(found.dtype).max), -1)
        return found

    def bytes_of(self, view: dict[str, Any], where: str) -> bytes:
        """The bytes of a buffer view."""
        self.one("buffers", view.get("buffer"), where)
        data, start, length = self._buffers[view["buffer"]], view.get("byteOffset") or 0, view.get("byteLength")
        if type(start) is not int or type(length) is not int or not 0 <= start <= start + length <= len(data):
            raise ValueError(f"{self.path}: {where}: bytes {start}+{length} do not lie in a buffer of {len(data)}")
        return data[start : start + length]

    def picture(self, index: Any, where: str) -> NDArray[np.uint8]:
        """An image as codes [h, w, 4], red first.

        Raises:
            ValueError: If it is no PNG or JPEG of 8 bits.
        """
        image = self.one("images", index, where)
        if "bufferView" in image:
            data = self.bytes_of(self.one("bufferViews", image["bufferView"], where), where)
        else:
            data = _content(self.path, image.get("uri"), where)
        found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
        if found is None or found.dtype != np.uint8:
            raise ValueError(f"{self.path}: {where} must be a PNG or JPEG of 8 bits")
        if found.ndim == 2 or found.shape[2] == 1:
            return np.asarray(cv2.cvtColor(found, cv2.COLOR_GRAY2RGBA), np.uint8)
        code = cv2.COLOR_BGR2RGBA if found.shape[2] == 3 else cv2.COLOR_BGRA2RGBA
        return np.asarray(cv2.cvtColor(found, code), np.uint8)


def read_document(path: Path, *, allow_outside: bool = False) -> GltfDocument:
    """Read a file, and check everything in it against the lists of `allowed`.

    Raises:
        ValueError: If it is not glTF 2.0, names a file outside its folder, or sets something that is not understood; or
            pygltflib, the extra gltf, is not installed.
    """
    path = resolved(path)
    data = read_bytes(path, most=MOST)
    binary = data[:4] == b"glTF"
    content = parse_json(as_text(_json_of(data, path) if binary else data, path), f"{path}")
    check_content(content, f"{path}")
    if content["asset"]["version"].partition(".")[0] != "2":
        raise ValueError(f"{path} must be glTF 2.0, got version {content['asset']['version']!r:.40}")
    buffers, files = _read_buffers(path, content, data if binary else None, allow_outside)
    return GltfDocument(path, content, files, buffers)


def _json_of(data: bytes, path: Path) -> bytes:
    """The first chunk of a binary file, whose chunks are all there."""
    at, end = 12, int.from_bytes(data[8:12], "little")
    first = struct.unpack("<I4s", data[12:20]) if len(data) >= 20 else (0, b"")
    while at < end:  # pygltflib relies on it
        at += 8 + int.from_bytes(data[at : at + 4], "little")
        if at > len(data):
            raise ValueError(f"{path} is cut short: get it again")
    if first[1] != b"JSON":
        raise ValueError(f"{path} is cut short or no binary glTF: get it again")
    return data[20 : 20 + first[0]]


def _read_buffers(
    path: Path, content: dict[str, Any], binary: bytes | None, allow_outside: bool
) -> tuple[list[bytes], tuple[Path, ...]]:
    """The bytes of every buffer, and all files of the scene."""
    try:
        from pygltflib import GLTF2
    except ModuleNotFoundError as error:
        raise ValueError("glTF scenes are read by pygltflib: pip install 'novags[gltf]'") from error
    uris = [entry.get("uri") for name in ("buffers", "images") for entry in content.get(name) or []]
    files = [_beside(path, uri, allow_outside) for uri in uris if isinstance(uri, str) and not uri.startswith("data:")]
    blob = None if binary is None else GLTF2.load_from_bytes(binary).binary_blob()
    buffers = []
    for k, buffer in enumerate(content.get("buffers") or []):
        data = _content(path, buffer["uri"], f"buffer {k}") if "uri" in buffer else blob or b""
        if len(data) < (buffer.get("byteLength") or 0):
            raise ValueError(f"{path}: buffer {k} has {len(data)} of {buffer['byteLength']} bytes: it is cut short")
        buffers.append(data)
    return buffers, (path, *dict.fromkeys(files))


def _beside(path: Path, uri: str, allow_outside: bool) -> Path:
    """The file that a relative address names."""
    if "://" in uri:
        raise ValueError(f"{path} names {uri!r:.100}: files must lie beside it, nothing is fetched")
    named = path.parent / unquote(uri)
    found = resolved(named)
    # By a link of the folder to where links may lead, as for the files of Mitsuba's scenes.
    linked = Path(os.path.normpath(named)).is_relative_to(path.parent) and is_given(str(found))
    if not (allow_outside or linked or found.is_relative_to(path.parent)):
        raise ValueError(f"{path} names {uri!r:.100}, outside its folder: move it there, or add --allow-outside "
                         "(allow_outside=True)")  # fmt: skip
    return found


def _content(path: Path, uri: Any, where: str) -> bytes:
    """The bytes behind an address: in it, or in a file that was admitted."""
    if not isinstance(uri, str):
        raise ValueError(f"{path}: {where} has no content")
    if uri.startswith("data:"):
        head, _, body = uri.partition(",")
        try:
            return (
                base64.b64decode(body, validate=True) if head.endswith(";base64") else unquote(body).encode("latin-1")
            )
        except ValueError as error:
            raise ValueError(f"{path}: {where}: its data address is damaged ({error})") from error
    try:
        return read_bytes(resolved(path.parent / unquote(uri)), most=MOST)
    except OSError as error:
        raise ValueError(f"{path}: {where} names {uri!r:.100}, which cannot be read: {error.strerror}") from error
