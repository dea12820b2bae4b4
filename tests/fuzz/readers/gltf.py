"""Scenes in glTF: as text with a buffer and a picture beside it, and in one file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.fuzz.case import Reader
from tests.fuzz.readers.scenes import loaded, with_mitsuba
from tests.simscenes.loading.gltf.writer import GltfWriter, floor

MATERIAL = {
    "pbrMetallicRoughness": {
        "baseColorFactor": [0.5, 0.6, 0.7, 1], "metallicFactor": 0.1, "roughnessFactor": 0.8,
        "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2], "rotation": 0.1}}},
    },
    "normalTexture": {"index": 0, "scale": 0.5}, "emissiveFactor": [0.1, 0.1, 0.2], "alphaMode": "MASK",
    "alphaCutoff": 0.4, "extensions": {"KHR_materials_ior": {"ior": 1.4}},
}  # fmt: skip
NODES: list[dict[str, Any]] = [
    {"mesh": 0, "rotation": [0, 0.1, 0, 0.995], "scale": [1, 1, 2], "children": [1]},
    {"translation": [0, 2, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
    {"camera": 0, "translation": [0, 1, 4]},
]
LIGHT = {"type": "spot", "intensity": 50, "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.6}}
CAMERA = {"type": "perspective", "perspective": {"yfov": 0.8, "aspectRatio": 1.3, "znear": 0.1}}


def _scene() -> GltfWriter:
    writer = floor(MATERIAL)
    writer.texture(np.full((4, 4, 3), 99, np.uint8), wrapS=10497, magFilter=9728)
    writer.content |= {
        "nodes": NODES, "scenes": [{"nodes": [0, 2]}], "cameras": [CAMERA],
        "extensions": {"KHR_lights_punctual": {"lights": [LIGHT]}},
        "extensionsUsed": ["KHR_lights_punctual", "KHR_texture_transform", "KHR_materials_ior"],
    }  # fmt: skip
    return writer


def make(folder: Path) -> None:
    """One file, and the same as text: its picture and its buffer are files, too."""
    writer = _scene()
    writer.write(folder / "whole.glb")
    (folder / "b.bin").write_bytes(writer.data)
    cv2.imwrite(str(folder / "t.png"), np.full((4, 4, 3), 99, np.uint8))
    buffers = [{"uri": "b.bin", "byteLength": len(writer.data)}]
    content = writer.content | {"buffers": buffers, "images": [{"uri": "t.png"}]}
    (folder / "scene.gltf").write_text(json.dumps(content))


def read(folder: Path, file: Path) -> object:
    """Load the scene that the file belongs to."""
    return loaded(folder / ("whole.glb" if file.name == "whole.glb" else "scene.gltf"))


FILES = ("scene.gltf", "whole.glb", "b.bin", "t.png")
READERS = [Reader("glTF scene", make, read, FILES, share=0.2, prepare=with_mitsuba)]
