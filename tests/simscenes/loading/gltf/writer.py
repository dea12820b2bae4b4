"""glTF files by hand: a square on the ground, and whatever a test adds."""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np

SQUARE = np.array([(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)], "<f4")  # in glTF's axes: flat on the ground, y up
CORNERS = np.array([0, 1, 2, 0, 2, 3], "<u2")
UV = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], "<f4")


class GltfWriter:
    """A glTF file, its arrays in one buffer."""

    def __init__(self) -> None:
        self.data = b""
        self.content: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "by hand"}, "scene": 0, "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": "floor"}], "accessors": [], "bufferViews": [], "buffers": [{}],
        }  # fmt: skip

    def view(self, data: bytes, **more: int) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.content["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data
        return len(self.content["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, **more: Any) -> int:
        kinds = {"<f4": 5126, "<u2": 5123, "|u1": 5121, "|i1": 5120}
        item = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[1 if values.ndim == 1 else values.shape[1]]
        self.content["accessors"].append({
            "bufferView": self.view(values.tobytes()), "componentType": kinds[values.dtype.str], "count": len(values),
            "type": item, **more,
        })  # fmt: skip
        return len(self.content["accessors"]) - 1

    def mesh(self, attributes: dict[str, np.ndarray], **primitive: Any) -> "GltfWriter":
        found = {name: self.accessor(values) for name, values in attributes.items()}
        part = {"attributes": found, "indices": self.accessor(CORNERS), **primitive}
        self.content.setdefault("meshes", []).append({"primitives": [part]})
        return self

    def texture(self, picture: np.ndarray, **sampler: int) -> int:
        _, png = cv2.imencode(".png", picture[..., ::-1] if picture.shape[2] == 3 else picture[..., [2, 1, 0, 3]])
        image = {"bufferView": self.view(png.tobytes()), "mimeType": "image/png"}
        for name, entry in (("images", image), ("samplers", sampler)):
            self.content.setdefault(name, []).append(entry)
        number = len(self.content["images"]) - 1
        self.content.setdefault("textures", []).append({"source": number, "sampler": number})
        return number

    def write(self, path: Path) -> Path:
        self.content["buffers"][0]["byteLength"] = len(self.data)
        if path.suffix == ".gltf":
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
            path.write_text(json.dumps(self.content | {"buffers": [{"uri": uri, "byteLength": len(self.data)}]}))
            return path
        text = json.dumps(self.content).encode()
        text, data = text + b" " * (-len(text) % 4), self.data + b"\0" * (-len(self.data) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path


def floor(material: dict[str, Any] | None = None, uv: bool = True, **attributes: np.ndarray) -> GltfWriter:
    """The square on the ground, with normals that point up."""
    up = np.tile(np.array([[0, 1, 0]], "<f4"), (4, 1))
    writer = GltfWriter()
    primitive = {} if material is None else {"material": 0}
    writer.mesh({"POSITION": SQUARE, "NORMAL": up, **({"TEXCOORD_0": UV} if uv else {}), **attributes}, **primitive)
    if material is not None:
        writer.content["materials"] = [material]
    return writer
