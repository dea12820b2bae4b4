"""The keys of a glTF 2.0 file that are understood, and the harmless ones. Any other key that is set is refused by name.

Sources: the core specification and the ratified extensions of KHR; the harmless keys are from the files that Blender's
exporter, Sketchfab and three.js write.
"""

from __future__ import annotations

from typing import Any

ANYWHERE = {"name", "extras"}  # change no picture
TEXTURE = {"index", "texCoord"}
# Keys by the kind of object that has them.
UNDERSTOOD: dict[str, set[str]] = {
    "file": {"asset", "scene", "scenes", "nodes", "meshes", "accessors", "bufferViews", "buffers", "materials",
             "textures", "images", "samplers", "cameras", "extensionsUsed", "extensionsRequired"},
    "scene": {"nodes"},
    "node": {"children", "mesh", "camera", "matrix", "translation", "rotation", "scale"},
    "mesh": {"primitives"},
    "primitive": {"attributes", "indices", "material", "mode"},
    "attributes": {"POSITION", "NORMAL", "TEXCOORD_0", "COLOR_0"},
    "material": {"pbrMetallicRoughness", "normalTexture", "emissiveFactor", "emissiveTexture", "alphaMode",
                 "alphaCutoff", "doubleSided"},
    "pbrMetallicRoughness": {"baseColorFactor", "baseColorTexture", "metallicFactor", "roughnessFactor",
                             "metallicRoughnessTexture"},
    "texture info": TEXTURE,
    "normal texture": TEXTURE | {"scale"},
    "texture": {"source", "sampler"},
    "image": {"uri", "mimeType", "bufferView"},
    "sampler": {"wrapS", "wrapT", "magFilter"},
    "camera": {"type", "perspective"},
    "perspective": {"yfov", "aspectRatio"},
    "accessor": {"bufferView", "byteOffset", "componentType", "normalized", "count", "type"},
    "bufferView": {"buffer", "byteOffset", "byteLength", "byteStride"},
    "buffer": {"uri", "byteLength"},
}  # fmt: skip
HARMLESS: dict[str, set[str]] = {  # a path tracer has no use for them
    "file": {"asset", "animations", "skins"},  # a moving node stands where it is; a skin is refused where it is used
    "attributes": {"TANGENT", "TEXCOORD_1", "TEXCOORD_2", "TEXCOORD_3", "COLOR_1"},  # refused where they are used
    "material": {"occlusionTexture"},  # shadows in corners, which the light itself makes here
    "sampler": {"minFilter"},
    "perspective": {"znear", "zfar"},
    "accessor": {"min", "max"},
    "bufferView": {"target"},
}
EXTENSIONS: dict[str, dict[str, set[str]]] = {  # understood, with their keys, by the kind of object that has them
    "file": {"KHR_lights_punctual": {"lights"}},
    "node": {"KHR_lights_punctual": {"light"}},
    "material": {"KHR_materials_emissive_strength": {"emissiveStrength"}, "KHR_materials_ior": {"ior"}},
    "texture info": {"KHR_texture_transform": {"offset", "rotation", "scale", "texCoord"}},
    "normal texture": {"KHR_texture_transform": {"offset", "rotation", "scale", "texCoord"}},
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
QUANTIZED = "KHR_mesh_quantization"  # integers as coordinates: the accessors say it all
ANNOUNCED = {QUANTIZED, *IDLE, *(name for of in EXTENSIONS.values() for name in of)}


def check_object(found: Any, kind: str, where: str) -> None:
    """Refuse an object of a file that sets a key which is not understood and may change a picture.

    Raises:
        ValueError: If it does, or is no object.
    """
    if not isinstance(found, dict):
        raise ValueError(f"{where} must be an object, got {found!r:.80}")
    known = UNDERSTOOD[kind] | HARMLESS.get(kind, set()) | ANYWHERE | {"extensions"}
    for key, value in found.items():
        if key not in known and is_set(value):
            raise ValueError(f"{where} sets {key!r}, which is not understood here and may change the pictures: export "
                             "it without")  # fmt: skip
    extensions = found.get("extensions") or {}
    for name, inner in extensions.items():
        _check_extension(name, inner, kind, where)


def _check_extension(name: str, found: Any, kind: str, where: str) -> None:
    if not isinstance(found, dict):
        raise ValueError(f"{where}, extension {name}, must be an object, got {found!r:.80}")
    if name in EXTENSIONS.get(kind, {}):
        if unknown := [key for key in found if key not in EXTENSIONS[kind][name] | ANYWHERE]:
            raise ValueError(f"{where}, extension {name}, sets {unknown[0]!r}, which is not understood: export without")
        return
    idle = kind == "material" and name in IDLE
    if not idle or any(found.get(key, ABSENT.get(key, 0)) != value for key, value in IDLE[name].items()):
        raise ValueError(f"{where} uses the extension {name}, which is not understood here: export without it (or "
                         "without the effect, such as transmission or a clear coat)")  # fmt: skip


def is_set(value: Any) -> bool:
    """Whether a value says anything: false, null and empty ones do not; 0 does, which is the number of an object."""
    return not (value is None or value is False or value in ("", [], {}, [0, 0, 0]))
