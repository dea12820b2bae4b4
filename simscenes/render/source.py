"""Scenes as they come in: a name of the catalogue or a Mitsuba dict; loaded, named and hashed the same way."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class LoadedScene:
    """A scene ready to render.

    Attributes:
        name: Catalogue name, or "custom".
        scene: The Mitsuba scene.
        digest: Hash of everything the picture depends on but the camera and the random numbers.
        shapes: Names of the shapes; the id of a pixel is 1 + place in this list.
        materials: Names of the materials, likewise.
    """

    name: str
    scene: Any
    digest: str
    shapes: tuple[str, ...]
    materials: tuple[str, ...]


def build_scene(scene: str | dict[str, Any] | Path, mi: Any) -> LoadedScene:
    """Load a scene under the active variant.

    Args:
        scene: A name from `SCENES`, optionally with a scene seed ("tabletop:3"), or a Mitsuba scene dict.
        mi: The mitsuba module, from `activate`.

    Raises:
        ValueError: If the name is unknown, or Mitsuba refuses the description (its reason is in the message).
    """
    from simscenes.scenes import build

    name = scene if isinstance(scene, str) else "custom"
    description = build(scene) if isinstance(scene, str) else scene
    if not isinstance(description, dict) or description.get("type") != "scene":
        raise ValueError(
            f"scene must be a name from SCENES or a Mitsuba dict of type 'scene', got {type(scene).__name__}"
        )
    for key, value in description.items():
        if isinstance(value, mi.Object):
            value.set_id(key)  # meshes made in Python do not know the name they have in the dict
    try:
        # optimize=True orders merged objects by memory address: other light order, other noise in every process.
        loaded = mi.load_dict(description, optimize=False)
    except Exception as error:  # Mitsuba raises RuntimeError for nearly everything
        raise ValueError(f"scene {name!r} cannot be loaded: {error}") from error
    if len(loaded.shapes()) == 0:
        raise ValueError(f"scene {name!r} has no shapes: there is nothing to see")
    shapes = tuple(s.id() for s in loaded.shapes())
    materials = tuple(_material_name(s) for s in unique_materials(loaded))
    return LoadedScene(name, loaded, scene_digest(loaded, mi), shapes, materials)


def unique_materials(scene: Any) -> list[Any]:
    """One shape for each distinct material, in the order of the shapes."""
    seen, first = set(), []
    for shape in scene.shapes():
        if shape.bsdf() is not None and shape.bsdf() not in seen:
            seen.add(shape.bsdf())
            first.append(shape)
    return first


def _material_name(shape: Any) -> str:
    own = shape.bsdf().id()
    return own if own and not own.startswith("__") else f"{shape.id()}.{shape.bsdf().class_name()}"


def scene_digest(scene: Any, mi: Any) -> str:
    """Hash the structure and every parameter of a loaded scene (sha256, 64 hex digits)."""
    digest = hashlib.sha256(str(scene).encode())
    params = mi.traverse(scene)
    for key in sorted(params.keys()):
        value = params[key]
        if hasattr(value, "matrix"):
            value = value.matrix
        digest.update(key.encode())
        digest.update(np.ascontiguousarray(np.array(value)).tobytes())
    return digest.hexdigest()
