"""Scenes as they come in: a catalogue name, a Mitsuba dict or an XML file; loaded, checked, named and hashed alike."""

from __future__ import annotations

import hashlib
import re
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simscenes.render.contents import unique_materials
from simscenes.render.physical import check_parameters, scene_extent
from simscenes.render.untrusted import check_plugin, check_xml, searching_only


@dataclass(frozen=True)
class LoadedScene:
    """A scene ready to render.

    Attributes:
        name: Catalogue name, name of the file, or "custom".
        variant: The Mitsuba variant it was loaded in, and the only one it can be used in.
        scene: The Mitsuba scene.
        digest: Hash of everything the picture depends on but the camera and the random numbers.
        shapes: Names of the shapes and instances; the id of a pixel is 1 + place in this list.
        materials: Names of the materials, likewise; those within instances too.
        extent: Diagonal of the bounding box, scene units.
    """

    name: str
    variant: str
    scene: Any
    digest: str
    shapes: tuple[str, ...]
    materials: tuple[str, ...]
    extent: float


def build_scene(scene: str | dict[str, Any] | Path, mi: Any, *, allow_outside: bool = False) -> LoadedScene:
    """Load a scene under the active variant.

    Args:
        scene: A name from `SCENES`, optionally with a scene seed ("tabletop:3"); a Mitsuba scene dict; or the path of a
            Mitsuba XML file (anything ending in .xml).
        mi: The mitsuba module, from `activate`.
        allow_outside: Let an XML file read files outside its own folder.

    Raises:
        ValueError: If the name is unknown, the file reaches outside its folder, Mitsuba refuses the description (its
            reason is in the message), there is no shape, or a number in it is not physical.
    """
    is_file = isinstance(scene, Path) or (isinstance(scene, str) and scene.endswith(".xml"))
    name = Path(str(scene)).stem if is_file else scene if isinstance(scene, str) else "custom"
    try:
        loaded = _load_xml(Path(str(scene)), mi, allow_outside) if is_file else _load_dict(scene, mi)
    except (RuntimeError, TypeError, KeyError, AttributeError) as error:  # what Mitsuba and its bindings raise
        raise ValueError(f"scene {name!r} cannot be loaded: {error}") from error
    if not isinstance(loaded, mi.Scene) or len(loaded.shapes()) == 0:
        raise ValueError(f"scene {name!r} has no shapes: there is nothing to see")
    if "spectral" not in mi.variant() and re.search(r"(Irr|R)egularSpectrum\[", str(loaded)):
        # Mitsuba would only find out while rendering.
        raise ValueError(f"scene {name!r} holds a 'regular' or 'irregular' spectrum, which only spectral variants can "
                         "read; write it as type 'spectrum' with pairs of wavelength and value")  # fmt: skip
    extent = scene_extent(loaded)
    params = mi.traverse(loaded)
    check_parameters(loaded, params, mi)
    shapes = tuple(s.id() for s in loaded.shapes())
    materials = tuple(_material_name(s) for s in unique_materials(loaded, mi))
    return LoadedScene(str(name), mi.variant(), loaded, scene_digest(loaded, params), shapes, materials, extent)


def has_measured_lights(scene: str | dict[str, Any] | Path) -> bool:
    """Whether a light is given as a spectrum; what is given as RGB has no spectrum but the one Mitsuba makes up."""
    from simscenes.scenes import MEASURED_LIGHTS, split_name

    if isinstance(scene, dict):
        return _has_spectral_light(scene)
    if isinstance(scene, str) and not scene.endswith(".xml"):
        return split_name(scene)[0] in MEASURED_LIGHTS
    text = Path(str(scene)).read_text(encoding="utf-8", errors="replace")
    return any(word in text for word in ("<spectrum", '"blackbody"', '"irregular"', '"regular"'))


def _has_spectral_light(node: dict[str, Any]) -> bool:
    kinds = ("spectrum", "regular", "irregular", "blackbody")
    nested = [(k, v) for k, v in node.items() if isinstance(v, dict)]
    lit = any(k in ("radiance", "irradiance", "intensity") and v.get("type") in kinds for k, v in nested)
    return lit or any(_has_spectral_light(v) for _, v in nested)


def _load_dict(scene: Any, mi: Any) -> Any:
    from simscenes.scenes import build

    description = build(scene) if isinstance(scene, str) else scene
    if not isinstance(description, dict) or description.get("type") != "scene":
        raise ValueError(
            f"scene must be a name from SCENES, a .xml file or a Mitsuba dict of type 'scene', got {scene!r:.80}"
        )
    _check_plugins(description)
    for key, value in description.items():
        if isinstance(value, mi.Object):
            value.set_id(key)  # meshes made in Python do not know the name they have in the dict
    # optimize=True orders merged objects by memory address: other light order, other noise in every process.
    return mi.load_dict(description, optimize=False)


def _check_plugins(node: dict[str, Any]) -> None:
    if isinstance(kind := node.get("type"), str):
        check_plugin(kind)
    for child in node.values():
        if isinstance(child, dict):
            _check_plugins(child)


def _load_xml(path: Path, mi: Any, allow_outside: bool) -> Any:
    file, *_ = check_xml(path, allow_outside=allow_outside)
    with nullcontext() if allow_outside else searching_only(file.parent, mi):
        return mi.load_file(str(file), optimize=False)


def set_light_weights(loaded: LoadedScene, weights: tuple[float, ...], mi: Any) -> None:
    """Let the scene pick its lights in proportion to `weights`, one per light; () leaves them alone.

    Raises:
        ValueError: If there are weights for another number of lights.
    """
    lights = loaded.scene.emitters()
    if weights and len(weights) != len(lights):
        raise ValueError(f"the plan weighs {len(weights)} lights, scene {loaded.name!r} has {len(lights)}: it was made "
                         "for another scene")  # fmt: skip
    for light, weight in zip(lights, weights, strict=False):
        params = mi.traverse(light)
        params["sampling_weight"] = weight
        params.update()
    loaded.scene.parameters_changed([])


def _material_name(shape: Any) -> str:
    own = shape.bsdf().id()
    return own if own and not own.startswith("__") else f"{shape.id()}.{shape.bsdf().class_name()}"


def scene_digest(scene: Any, params: Any) -> str:
    """Hash the structure and every parameter of a loaded scene (sha256, 64 hex digits)."""
    digest = hashlib.sha256(str(scene).encode())
    for key in sorted(params.keys()):
        value = params[key]
        if "Transform" in type(value).__name__:
            value = value.matrix
        digest.update(key.encode())
        digest.update(np.ascontiguousarray(np.array(value)).tobytes())
    return digest.hexdigest()
