"""A glTF scene as a Mitsuba dict: meshes in the world, lights of KHR_lights_punctual, cameras.

glTF's y is up; here z is. Metres stay scene units, and photometric units are taken as Mitsuba's: candela as intensity,
lux as irradiance, nits as radiance, so that all lights keep their proportions.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.loading.gltf.document import GltfDocument
from simscenes.loading.gltf.materials import Painted, painted

Dict = dict[str, Any]
Matrix = NDArray[np.float64]
UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # y up -> z up
BEHIND = np.diag([-1.0, 1, -1, 1])  # glTF looks and shines along -z, Mitsuba along z
TRIANGLES = 4
MOST_NODES = 10**6
ROWS = 576  # px of a camera's film, whose shape counts: the size of pictures is asked for elsewhere


def described(document: GltfDocument, folder: Path, mi: Any) -> Dict:
    """The Mitsuba dict of a file's scene; meshes are written as PLY files into a folder that the caller removes.

    Raises:
        ValueError: If something in it is not understood or damaged.
    """
    scene: Dict = {"type": "scene"}
    lights = ((document.content.get("extensions") or {}).get("KHR_lights_punctual") or {}).get("lights") or []
    if document.content.get("animations"):
        warnings.warn(
            f"{document.path} holds animations: everything stands as its nodes say, at no time of them", stacklevel=2
        )
    materials: dict[tuple[int | None, bool], Painted] = {}
    for number, (node, matrix, called) in enumerate(_placed(document)):
        if "mesh" in node:
            mesh = document.one("meshes", node["mesh"], called)
            for k, primitive in enumerate(mesh.get("primitives") or []):
                name = f"{called}.{k}" if len(mesh["primitives"]) > 1 else called
                scene[_free(scene, name)] = _shape(
                    document, primitive, matrix, folder / f"{number}-{k}.ply", name, materials, mi
                )
        if "camera" in node:
            camera = document.one("cameras", node["camera"], called)
            if (sensor := _sensor(document, camera, matrix, called, mi)) is not None:
                scene[_free(scene, called)] = sensor
        light = ((node.get("extensions") or {}).get("KHR_lights_punctual") or {}).get("light")
        if light is not None:
            if type(light) is not int or not 0 <= light < len(lights):
                raise ValueError(f"{document.path}: {called} names light {light!r:.40} of {len(lights)}: it is damaged")
            scene[_free(scene, called)] = _light(document, lights[light], matrix, called, mi)
    return scene


def _free(scene: Dict, name: str) -> str:
    """A key that the scene has not; Mitsuba allows no dot in it."""
    name = "".join(c if c.isalnum() or c in "_-" else "_" for c in name) or "object"
    return name if name not in scene else next(key for k in range(2, 10**9) if (key := f"{name}-{k}") not in scene)


def _placed(document: GltfDocument) -> Iterator[tuple[Dict, Matrix, str]]:
    """Every node of the scene in use, with its place in the world (z up) and its name."""
    scenes = document.all("scenes")
    roots = document.one("scenes", document.content.get("scene", 0), "the file").get("nodes") or [] if scenes else []
    waiting = [(index, UPRIGHT, 0) for index in reversed(roots)]
    seen = 0
    while waiting:
        index, above, depth = waiting.pop()
        node = document.one("nodes", index, "a node")
        seen += 1
        if seen > MOST_NODES or depth > len(document.all("nodes")):
            raise ValueError(f"{document.path}: its nodes hold each other in a circle, or are more than {MOST_NODES:,}")
        name = node.get("name")
        matrix = above @ _local(document, node, index)
        yield node, matrix, name if isinstance(name, str) and name else f"node {index}"
        waiting += [(child, matrix, depth + 1) for child in reversed(node.get("children") or [])]


def _local(document: GltfDocument, node: Dict, index: int) -> Matrix:
    def numbers(name: str, default: list[float]) -> NDArray[np.float64]:
        values = np.asarray(node.get(name, default), np.float64)
        if values.shape != (len(default),) or not np.isfinite(values).all():
            raise ValueError(f"{document.path}: {name} of node {index} must be {len(default)} finite numbers")
        return values

    if "matrix" in node:
        return numbers("matrix", [0.0] * 16).reshape(4, 4).T
    x, y, z, w = numbers("rotation", [0, 0, 0, 1])
    length = math.hypot(x, y, z, w)
    if abs(length - 1) > 1e-2:
        raise ValueError(f"{document.path}: rotation of node {index} must be a unit quaternion, got length {length:g}")
    x, y, z, w = (value / length for value in (x, y, z, w))
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    local = np.eye(4)
    local[:3, :3], local[:3, 3] = turn * numbers("scale", [1, 1, 1]), numbers("translation", [0, 0, 0])
    return local


def _shape(
    document: GltfDocument,
    primitive: Dict,
    matrix: Matrix,
    file: Path,
    name: str,
    materials: dict[tuple[int | None, bool], Painted],
    mi: Any,
) -> Dict:
    """One mesh with its material, its vertices in the world."""
    if (mode := primitive.get("mode", TRIANGLES)) != TRIANGLES:
        raise ValueError(
            f"{document.path}: {name} is drawn in mode {mode}: triangles (4) alone are understood; convert it"
        )
    attributes = primitive.get("attributes") or {}
    points = document.array(attributes.get("POSITION"), f"positions of {name}").astype(np.float64)
    columns = {"xyz": points @ matrix[:3, :3].T + matrix[:3, 3]}
    faces = _faces(document, primitive, len(points), name)
    if np.linalg.det(matrix[:3, :3]) < 0:
        faces = faces[:, ::-1]  # a mirror turns the corners round
    if "NORMAL" in attributes:
        normals = document.array(attributes["NORMAL"], f"normals of {name}") @ np.linalg.inv(matrix[:3, :3])
        columns["normal"] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    if "TEXCOORD_0" in attributes:
        columns["uv"] = document.array(attributes["TEXCOORD_0"], f"texture coordinates of {name}")
    if bad := [what for what, values in columns.items() if len(values) != len(points) or not np.isfinite(values).all()]:
        raise ValueError(
            f"{document.path}: {bad[0]} of {name} must be {len(points)} rows of finite numbers: it is damaged"
        )
    colors = _vertex_colors(document, primitive, len(points), name)
    if colors is not None:
        columns["color"] = colors
    key = (primitive.get("material"), colors is not None)
    material = materials.get(key) or materials.setdefault(key, painted(document, key[0], key[1], mi))
    if colors is not None and not material.coloured:
        raise ValueError(
            f"{document.path}: {name} has colours of vertices under a texture of its base colour: bake them"
        )
    if material.bumpy and "uv" in columns and (share := _mirrored(columns["uv"], faces)) > 0:
        warnings.warn(f"{document.path}: the normal map of {name} lies mirrored on {share:.0%} of its faces: bumps are "
                      "turned upside down there. Unwrap it without mirrored islands", stacklevel=3)  # fmt: skip
    if material.emitter is not None and material.both_sides and _is_open(columns["xyz"], faces):
        warnings.warn(f"{document.path}: {name} shines from its front alone, the side that its normals point to: "
                      "Mitsuba knows no lamp of both sides (doubleSided)", stacklevel=3)  # fmt: skip
    write_ply(file, columns, faces)
    shape: Dict = {"type": "ply", "filename": str(file), "face_normals": "normal" not in columns, "bsdf": material.bsdf}
    return shape if material.emitter is None else shape | {"emitter": material.emitter}


def _faces(document: GltfDocument, primitive: Dict, count: int, name: str) -> NDArray[np.int64]:
    if "indices" not in primitive:
        corners = np.arange(count)
    else:
        corners = document.array(primitive["indices"], f"indices of {name}").ravel().astype(np.int64)
    if len(corners) % 3 or corners.max() >= count:
        raise ValueError(f"{document.path}: {name}: {len(corners)} corners up to {corners.max()} are no triangles "
                         f"of {count} vertices: it is damaged")  # fmt: skip
    return corners.reshape(-1, 3)


def _is_open(points: NDArray[Any], faces: NDArray[np.int64]) -> bool:
    """Whether the back of a mesh can be seen: some edge belongs to one face alone."""
    _, same = np.unique(points, axis=0, return_inverse=True)  # seams of texture coordinates split vertices
    edges = np.sort(same.reshape(-1)[faces][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 1).any())


def _mirrored(uv: NDArray[Any], faces: NDArray[np.int64]) -> float:
    """The share of faces on which a picture lies mirrored: v counts downwards, so that an upright one turns right."""
    first, second = uv[faces[:, 1]] - uv[faces[:, 0]], uv[faces[:, 2]] - uv[faces[:, 0]]
    return float((first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] > 0).mean())


def _vertex_colors(document: GltfDocument, primitive: Dict, count: int, name: str) -> NDArray[np.float64] | None:
    """The base colour of each vertex; None where no vertex has one, or all are white."""
    index = (primitive.get("attributes") or {}).get("COLOR_0")
    if index is None:
        return None
    colors = document.array(index, f"colours of {name}").astype(np.float64)
    ok = colors.shape[0] == count and colors.shape[1] in (3, 4) and 0 <= colors.min() and colors.max() <= 1
    if not ok:
        raise ValueError(f"{document.path}: colours of {name} must be 3 or 4 numbers in 0..1 for each vertex")
    if colors.shape[1] == 4 and colors[:, 3].min() < 1:
        raise ValueError(f"{document.path}: colours of {name} have an alpha below 1, which is not understood: bake it")
    if colors.min() == 1:
        return None
    material = primitive.get("material")
    pbr = {} if material is None else document.one("materials", material, name).get("pbrMetallicRoughness") or {}
    return colors[:, :3] * np.asarray(pbr.get("baseColorFactor", [1, 1, 1, 1])[:3])


def write_ply(file: Path, columns: dict[str, NDArray[Any]], faces: NDArray[np.int64]) -> None:
    """A binary PLY with the names that Mitsuba reads."""
    names = {"xyz": ("x", "y", "z"), "normal": ("nx", "ny", "nz"), "uv": ("u", "v"), "color": ("r", "g", "b")}
    head = [f"property float {axis}" for what in columns for axis in names[what]]
    rows = np.concatenate([np.asarray(values, "<f4") for values in columns.values()], 1)
    corners = np.empty(len(faces), [("count", "u1"), ("of", "<i4", 3)])
    corners["count"], corners["of"] = 3, faces
    text = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *head,
            f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]  # fmt: skip
    file.write_bytes("\n".join(text).encode() + rows.tobytes() + corners.tobytes())


def _frame(matrix: Matrix, mi: Any) -> Any:
    """Where a lamp or camera stands and looks, without its scale, for Mitsuba."""
    turn, _, other = np.linalg.svd(matrix[:3, :3])
    placed = np.eye(4)
    placed[:3, :3], placed[:3, 3] = turn @ other, matrix[:3, 3]
    return mi.ScalarTransform4f(placed @ BEHIND)


def _sensor(document: GltfDocument, camera: Dict, matrix: Matrix, name: str, mi: Any) -> Dict | None:
    lens = camera.get("perspective") or {}
    if camera.get("type") != "perspective":
        warnings.warn(f"{document.path}: {name} is a {camera.get('type')!r:.40} camera, and left out", stacklevel=3)
        return None
    yfov, aspect = lens.get("yfov"), lens.get("aspectRatio", 4 / 3)
    if not (
        isinstance(yfov, int | float) and 0 < yfov < math.pi and isinstance(aspect, int | float) and 0 < aspect < 100
    ):
        raise ValueError(f"{document.path}: {name} must have a yfov in 0..pi and an aspectRatio > 0, got {lens!r:.80}")
    film = {"type": "hdrfilm", "width": max(1, round(ROWS * aspect)), "height": ROWS}
    return {
        "type": "perspective",
        "fov": math.degrees(yfov),
        "fov_axis": "y",
        "to_world": _frame(matrix, mi),
        "film": film,
    }


def _light(document: GltfDocument, light: Dict, matrix: Matrix, name: str, mi: Any) -> Dict:
    """A lamp of KHR_lights_punctual."""
    kind, strength, color = (
        light.get("type"),
        light.get("intensity", 1.0),
        np.asarray(light.get("color", [1, 1, 1]), float),
    )
    ok = color.shape == (3,) and isinstance(strength, int | float) and 0 <= strength < math.inf and (color >= 0).all()
    if not ok or kind not in ("point", "spot", "directional"):
        raise ValueError(f"{document.path}: {name}: the light {light!r:.200} is not understood")
    rgb = {"type": "rgb", "value": (strength * color).tolist()}
    if kind == "directional":
        return {"type": "directional", "to_world": _frame(matrix, mi), "irradiance": rgb}
    if light.get("range"):
        warnings.warn(
            f"{document.path}: {name} has a range of {light['range']:g}: light knows none, and goes on", stacklevel=3
        )
    if kind == "point":
        return {"type": "point", "position": matrix[:3, 3].tolist(), "intensity": rgb}
    cone = light.get("spot") or {}
    inner, outer = cone.get("innerConeAngle", 0.0), cone.get("outerConeAngle", math.pi / 4)
    if not 0 <= inner <= outer <= math.pi / 2:
        raise ValueError(f"{document.path}: {name}: cone angles must rise within 0..pi/2, got {inner} and {outer}")
    warnings.warn(f"{document.path}: between its inner and its outer cone {name} falls off as Mitsuba's spot, linearly "
                  "in the angle, and not as glTF's", stacklevel=3)  # fmt: skip
    return {"type": "spot", "to_world": _frame(matrix, mi), "intensity": rgb, "cutoff_angle": math.degrees(outer),
            "beam_width": math.degrees(inner)}  # fmt: skip
