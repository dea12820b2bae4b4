"""Metallic-roughness materials as Mitsuba's principled BSDF.

Source: glTF 2.0, section 3.9 and appendix B: base colour, metallic and roughness (its square is the width of the lobe)
are Mitsuba's parameters of the same names. Both faces of a surface are painted: glTF's culled backs save a game the
drawing, and nothing in the world is seen through from behind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.isp import srgb_to_linear
from simscenes.loading.gltf.document import GltfDocument

Dict = dict[str, Any]
WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
NEAREST = 9728
MODES = ("OPAQUE", "MASK", "BLEND")
IOR = 1.5  # of the specification, where KHR_materials_ior says nothing


@dataclass(frozen=True)
class Painted:
    """A material for Mitsuba.

    Attributes:
        bsdf: Description of the BSDF.
        emitter: Description of the area light; None: it does not shine.
        coloured: Whether colours of vertices may multiply its base colour: it is no texture.
        bumpy: Whether it has a normal map.
        both_sides: Whether the file wants both its faces seen.
    """

    bsdf: Dict
    emitter: Dict | None
    coloured: bool
    bumpy: bool
    both_sides: bool


def painted(document: GltfDocument, index: int | None, vertex_colors: bool, mi: Any) -> Painted:
    """The material of this number; None: the specification's default, white and rough.

    Args:
        document: The file.
        index: Of the material.
        vertex_colors: Whether the mesh has an attribute "vertex_color", which holds the whole base colour.
        mi: The mitsuba module.

    Raises:
        ValueError: If it is not understood.
    """
    found = {} if index is None else document.one("materials", index, "a primitive")
    where = f"material {index}"
    pbr = found.get("pbrMetallicRoughness") or {}
    textures = _Textures(document, where, mi)
    base, alpha = textures.base_color(pbr, vertex_colors)
    rough, metal = textures.roughness(pbr)
    extensions = found.get("extensions") or {}
    ior = (extensions.get("KHR_materials_ior") or {}).get("ior", IOR)
    if not 1 <= ior <= 3:
        raise ValueError(f"{document.path}: {where}: ior must lie in 1..3, got {ior}: export without it")
    bsdf: Dict = {"type": "principled", "base_color": base, "roughness": rough, "metallic": metal, "eta": ior}
    if normal := found.get("normalTexture"):
        bsdf = {"type": "normalmap", "normalmap": textures.normals(normal), "bsdf": bsdf}
    bsdf = {"type": "twosided", "bsdf": bsdf}
    if (opacity := textures.opacity(found, alpha)) is not None:
        bsdf = {"type": "mask", "opacity": opacity, "bsdf": bsdf}
    emitter = textures.emission(found, (extensions.get("KHR_materials_emissive_strength") or {}))
    return Painted(bsdf, emitter, "baseColorTexture" not in pbr, bool(normal), bool(found.get("doubleSided")))


@dataclass
class _Textures:
    """The inputs of one material as Mitsuba's textures."""

    document: GltfDocument
    where: str
    mi: Any

    def base_color(
        self, pbr: Dict, vertex_colors: bool
    ) -> tuple[Dict, tuple[NDArray[np.floating[Any]] | None, Dict, float]]:
        """The colour; and the alpha of its texture (None: no texture), the texture's description, and its factor."""
        factor = self._factor(pbr, "baseColorFactor", 4)
        info = pbr.get("baseColorTexture")
        if info is None:
            if vertex_colors:
                return {"type": "mesh_attribute", "name": "vertex_color"}, (None, {}, factor[3])
            return {"type": "rgb", "value": list(factor[:3])}, (None, {}, factor[3])
        codes, how = self._texture(info)
        color = _linear(codes) * np.asarray(factor[:3], np.float32)
        return self._bitmap(color, how), (codes[..., 3] / np.float32(255), how, factor[3])

    def roughness(self, pbr: Dict) -> tuple[Any, Any]:
        """Roughness and metallic: green and blue of one texture, or numbers."""
        rough, metal = (self._number(pbr, name, 1.0, 1.0) for name in ("roughnessFactor", "metallicFactor"))
        info = pbr.get("metallicRoughnessTexture")
        if info is None:
            return rough, metal
        codes, how = self._texture(info)
        share = codes / np.float32(255)
        return self._bitmap(share[..., 1:2] * rough, how, raw=True), self._bitmap(
            share[..., 2:3] * metal, how, raw=True
        )

    def normals(self, info: Dict) -> Dict:
        """The normal map, scaled. Mitsuba's second axis is the first, turned by 90 degrees: up in the picture."""
        codes, how = self._texture(info)
        scale = self._number(info, "scale", 1.0, 10.0)
        normal = codes[..., :3] / np.float32(127.5) - 1
        normal = normal * np.array([scale, scale, 1], np.float32)
        normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-6)  # a grey texel has no direction
        return self._bitmap((normal + 1) / 2, how, raw=True)

    def opacity(self, found: Dict, alpha: tuple[NDArray[np.floating[Any]] | None, Dict, float]) -> Any:
        """The share of light that the surface stops; None: all of it."""
        mode = found.get("alphaMode") or "OPAQUE"
        if mode not in MODES:
            raise ValueError(f"{self.document.path}: {self.where}: alphaMode must be one of {MODES}, got {mode!r:.40}")
        texels, how, factor = alpha
        if mode == "OPAQUE":
            return None
        whole = (np.ones((1, 1), np.float32) if texels is None else texels) * np.float32(factor)
        if mode == "MASK":
            whole = (whole >= self._number(found, "alphaCutoff", 0.5, 1.0)).astype(np.float32)
        if whole.min() == 1:
            return None
        return float(whole[0, 0]) if texels is None else self._bitmap(whole[..., None], how, raw=True)

    def emission(self, found: Dict, strength: Dict) -> Dict | None:
        """The light that it sends, nits taken as radiance."""
        factor = np.asarray(self._factor(found, "emissiveFactor", 3, 0.0), np.float32)
        factor = factor * np.float32(self._number(strength, "emissiveStrength", 1.0, 1e9))
        if factor.max() == 0:
            return None
        if (info := found.get("emissiveTexture")) is None:
            return {"type": "area", "radiance": {"type": "rgb", "value": factor.tolist()}}
        codes, how = self._texture(info)
        return {"type": "area", "radiance": self._bitmap(_linear(codes) * factor, how)}

    def _factor(self, found: Dict, name: str, count: int, default: float = 1.0) -> tuple[float, ...]:
        values = found.get(name, [default] * count)
        ok = isinstance(values, list) and len(values) == count and all(_in(value, 0, 1) for value in values)
        if not ok:
            raise ValueError(
                f"{self.document.path}: {self.where}: {name} must be {count} numbers in 0..1, got {values!r:.80}"
            )
        return tuple(map(float, values))

    def _number(self, found: Dict, name: str, default: float, most: float) -> float:
        value = found.get(name, default)
        if not _in(value, 0, most):
            raise ValueError(f"{self.document.path}: {self.where}: {name} must lie in 0..{most:g}, got {value!r:.40}")
        return float(value)

    def _texture(self, info: Dict) -> tuple[NDArray[np.uint8], Dict]:
        """Codes of a texture [h, w, 4], and how it is laid on the surface."""
        where = f"a texture of {self.where}"
        texture = self.document.one("textures", info.get("index"), where)
        transform = (info.get("extensions") or {}).get("KHR_texture_transform") or {}
        if transform.get("texCoord", info.get("texCoord", 0)) != 0:
            raise ValueError(f"{self.document.path}: {where} lies by another set of texture coordinates than "
                             "the first, which alone is read: export with one set")  # fmt: skip
        sampler = {} if "sampler" not in texture else self.document.one("samplers", texture["sampler"], where)
        wraps = {WRAPS.get(sampler.get(name, 10497)) for name in ("wrapS", "wrapT")}
        if len(wraps) != 1 or None in wraps:
            raise ValueError(
                f"{self.document.path}: {where} repeats otherwise along u than along v: bake it, or export with one"
            )
        nearest = sampler.get("magFilter") == NEAREST
        how = {
            "wrap_mode": wraps.pop(),
            "filter_type": "nearest" if nearest else "bilinear",
            "to_uv": self._to_uv(transform),
        }
        return self.document.picture(texture.get("source"), where), how

    def _to_uv(self, transform: Dict) -> Any:
        """KHR_texture_transform: scale, then rotation, then offset.

        The text of the extension prints another matrix; three.js, Babylon, Blender and the sample model agree on this.
        """
        turn, (sx, sy), (x, y) = (
            transform.get("rotation", 0.0),
            transform.get("scale", (1, 1)),
            transform.get("offset", (0, 0)),
        )
        c, s = np.cos(turn), np.sin(turn)
        return self.mi.ScalarTransform3f(np.array([[c * sx, s * sy, x], [-s * sx, c * sy, y], [0, 0, 1]]))

    def _bitmap(self, texels: NDArray[np.floating[Any]], how: Dict, raw: bool = False) -> Dict:
        data = np.ascontiguousarray(texels, np.float32)
        return {"type": "bitmap", "bitmap": self.mi.Bitmap(data), "raw": raw, **how}


def _in(value: Any, low: float, high: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


def _linear(codes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Linear light of sRGB codes [h, w, 4], without alpha."""
    return np.asarray(srgb_to_linear(np.arange(256) / 255), np.float32)[codes[..., :3]]
