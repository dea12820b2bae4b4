"""The keys of a glTF 2.0 file that are understood, and the harmless ones. Any other key that is set is refused by name.

Sources: the core specification and the ratified extensions of KHR; the harmless keys are from the files that Blender's
exporter, Sketchfab and three.js write.
"""

from __future__ import annotations

from typing import Any

from sensor_model.files.records import Numbers, Shape, check_shape

_PAIR, _TRIPLE = Numbers(2), Numbers(3)
_TRANSFORM: Shape = {"offset?": _PAIR, "rotation?": float, "scale?": _PAIR, "texCoord?": int}
_TEXTURED: Shape = {"index": int, "texCoord?": int, "extensions?": {"KHR_texture_transform?": _TRANSFORM}}
_LIGHT: Shape = {"type": str, "color?": _TRIPLE, "intensity?": float, "range?": float,
                 "spot?": {"innerConeAngle?": float, "outerConeAngle?": float}}  # fmt: skip
_ATTRIBUTES: Shape = {"POSITION": int, "NORMAL?": int, "TEXCOORD_0?": int, "COLOR_0?": int}
_PBR: Shape = {"baseColorFactor?": Numbers(4), "baseColorTexture?": _TEXTURED, "metallicFactor?": float,
               "roughnessFactor?": float, "metallicRoughnessTexture?": _TEXTURED}  # fmt: skip
# What is understood, by the list that holds it: all values must be of these shapes, and no other key may be set.
UNDERSTOOD: dict[str, Shape] = {
    "scenes": {"nodes?": [int]},
    "nodes": {"children?": [int], "mesh?": int, "camera?": int, "matrix?": Numbers(16), "translation?": _TRIPLE,
              "rotation?": Numbers(4), "scale?": _TRIPLE, "extensions?": {"KHR_lights_punctual?": {"light": int}}},
    "meshes": {"primitives": [{"attributes": _ATTRIBUTES, "indices?": int, "material?": int, "mode?": int,
                                "extensions?": {}}]},
    "materials": {"pbrMetallicRoughness?": _PBR, "normalTexture?": _TEXTURED | {"scale?": float},
                  "emissiveFactor?": _TRIPLE, "emissiveTexture?": _TEXTURED, "alphaMode?": str, "alphaCutoff?": float,
                  "doubleSided?": bool, "extensions?": {
                      "KHR_materials_emissive_strength?": {"emissiveStrength?": float},
                      "KHR_materials_ior?": {"ior?": float}}},
    "textures": {"source": int, "sampler?": int},
    "images": {"uri?": str, "mimeType?": str, "bufferView?": int},
    "samplers": {"wrapS?": int, "wrapT?": int, "magFilter?": int},
    "cameras": {"type": str, "perspective?": {"yfov": float, "aspectRatio?": float}},
    "accessors": {"bufferView?": int, "byteOffset?": int, "componentType": int, "normalized?": bool, "count": int,
                  "type": str},
    "bufferViews": {"buffer": int, "byteOffset?": int, "byteLength": int, "byteStride?": int},
    "buffers": {"uri?": str, "byteLength": int},
}  # fmt: skip
FILE: Shape = {f"{name}?": [shape] for name, shape in UNDERSTOOD.items()} | {
    "asset": {"version": str}, "scene?": int, "extensionsUsed?": [str], "extensionsRequired?": [str],
    "extensions?": {"KHR_lights_punctual?": {"lights?": [_LIGHT]}},
}  # fmt: skip
ANYWHERE = {"name", "extras"}  # change no picture
HARMLESS: dict[str, set[str]] = {  # a path tracer has no use for them, by the last name on the way to them
    "extensions": {"KHR_xmp", "KHR_xmp_json_ld", "KHR_materials_variants"},  # who made it; other looks than its own
    "": {"animations", "skins"},  # a moving node stands where it is; a skin is refused where it is used
    "asset": {"generator", "copyright", "minVersion"},
    "attributes": {"TANGENT", "TEXCOORD_1", "TEXCOORD_2", "TEXCOORD_3", "COLOR_1"},  # refused where they are used
    "materials": {"occlusionTexture"},  # shadows in corners, which the light itself makes here
    "samplers": {"minFilter"},
    "perspective": {"znear", "zfar"},
    "accessors": {"min", "max"},
    "bufferViews": {"target"},
}
# Extensions of a material that do nothing at these values, which exporters write.
IDLE: dict[str, dict[str, Any]] = {
    "KHR_materials_transmission": {"transmissionFactor": 0},
    "KHR_materials_clearcoat": {"clearcoatFactor": 0},
    "KHR_materials_sheen": {"sheenColorFactor": [0, 0, 0]},
    "KHR_materials_specular": {"specularFactor": 1, "specularColorFactor": [1, 1, 1]},
    "KHR_materials_iridescence": {"iridescenceFactor": 0},
    "KHR_materials_anisotropy": {"anisotropyStrength": 0},
    "KHR_materials_dispersion": {"dispersion": 0},
    "KHR_materials_volume": {"thicknessFactor": 0},
}
ABSENT: dict[str, Any] = {  # the specification's defaults where they differ from "nothing"
    "specularFactor": 1, "specularColorFactor": [1, 1, 1], "sheenColorFactor": [0, 0, 0],
}  # fmt: skip
REQUIRED = {"KHR_mesh_quantization", "KHR_lights_punctual", "KHR_texture_transform", "KHR_materials_emissive_strength",
            "KHR_materials_ior", *IDLE}  # fmt: skip


def check_content(content: Any, where: str) -> None:
    """Refuse the JSON of a file in which something is set that is not understood, or that has another shape.

    Raises:
        ValueError: If there is such a thing, with its place.
    """
    if isinstance(content, dict):
        for name in content.get("extensionsRequired") or []:
            if name not in REQUIRED:
                raise ValueError(f"{where} requires the extension {name!r:.60}, which is not understood: export it "
                                 "without (compressed meshes: without compression)")  # fmt: skip
        _check_keys(content, FILE, "", where)
    check_shape(content, FILE, where, "it is damaged or no glTF 2.0")


def _check_keys(found: Any, shape: Shape, name: str, where: str) -> None:
    """Every key below an object or a list, which is called `name`."""
    if isinstance(shape, list) and isinstance(found, list):
        for k, part in enumerate(found):
            _check_keys(part, shape[0], name, f"{where}[{k}]{_called(part)}")
    if not (isinstance(shape, dict) and isinstance(found, dict)):
        return
    inner = {key.removesuffix("?"): value for key, value in shape.items()}
    for key, value in found.items():
        if key in inner:
            _check_keys(value, inner[key], key, f"{where}, {key}" if name else f"{where}: {key}")
        elif name == "extensions" and key in IDLE:
            _check_idle(key, value, where)
        elif key not in HARMLESS.get(name, set()) | ANYWHERE and (name == "extensions" or is_set(value)):
            raise ValueError(f"{where} sets {key!r:.60}, which is not understood here and may change the pictures: "
                             "export it without")  # fmt: skip


def _check_idle(name: str, found: Any, where: str) -> None:
    idle = IDLE[name]
    if not isinstance(found, dict) or any(found.get(key, ABSENT.get(key, 0)) != value for key, value in idle.items()):
        raise ValueError(f"{where} uses {name}, which is not understood here: export without it (such as without "
                         "transmission or a clear coat)")  # fmt: skip


def _called(part: Any) -> str:
    name = part.get("name") if isinstance(part, dict) else None
    return f" ({name:.60})" if isinstance(name, str) and name else ""


def is_set(value: Any) -> bool:
    """Whether a value says anything: false, null and empty ones do not; 0 does, which is the number of an object."""
    return not (value is None or value is False or value in ("", [], {}, [0, 0, 0]))
